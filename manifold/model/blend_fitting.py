"""Maps of blends fitted to materials: a layout by differences in appearance, and colour paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.measured import MeasuredBRDF, all_isotropic
from manifold.brdf.valleys import profile_pairs, squared_valleys, valley_depth
from manifold.colour import ball_colours
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.latent.blending import Layout, blend_layout
from manifold.latent.colour_paths import fit_paths
from manifold.latent.decoder import EncodingPairs
from manifold.latent.kernels import Kernel
from manifold.model.appearance import AppearancePairs, appearance_pairs, roots_at
from manifold.model.blend_space import BlendSpace
from manifold.model.decoding import integrating_sphere
from manifold.records import Array, Indices, Progress, evenly_spaced
from manifold.system.stages import with_progress

_BANDS = 12  # in which materials are compared, evenly spaced
_FLOOR = 1e-2  # 1/sr, added before logarithms: smaller values look black
_UNIT = 20.0  # CIEDE2000 of the ball per unit of distance, before the layout is scaled
# Depth allowed in all blends: few measured materials have a deeper valley; where one has, blends with it may.
_MEASURED_VALLEY = 0.08
_VALLEY_APART = 300.0  # CIEDE2000 between two materials per depth of the valley in their blend, added
_VALLEY_COST = 10.0  # of valleys in blends of two, against stress
_SQUARED_VALLEY_COST = 6000.0  # of squared depths in blends of several, against stress
_PROFILE_BANDS, _PROFILE_STRIDE = 4, 2  # bands and stride of directions, of profiles of blends of several
_ALBEDO_INCIDENCES_DEG = (0.0, 30.0, 60.0, 75.0)
_SHARES = (0.2, 0.5, 0.8)  # of the first material, in the blends of two that are evaluated


@dataclass(frozen=True, eq=False)
class AppearanceDistances:
    """Appearance distances between N materials.

    Attributes:
        ball: mean CIEDE2000 between their balls, shape (N, N).
        shape: distance of their logarithms, scaled to the median of `ball`, shape (N, N).
        valley: depth of in-plane minima near the mirror direction in blends of two, beyond `allowed`, shape (N, N).
        allowed: depth of such minima that blends with a material may have, shape (N,).
        profiles: cube roots in the plane of incidence near the mirror direction, shape (N, I, D, B).
    """

    ball: Array
    shape: Array
    valley: Array
    allowed: Array
    profiles: Array

    def subset(self, materials: Indices) -> AppearanceDistances:
        """The distances between some of the materials."""
        rows = np.ix_(materials, materials)
        return AppearanceDistances(
            self.ball[rows], self.shape[rows], self.valley[rows], self.allowed[materials],
            self.profiles[materials],
        )  # fmt: skip

    def layout(self, latent_dim: int) -> Layout:
        """Places of the materials in Q dimensions, in units of the kernel's length scale."""
        distance = np.hypot(0.5 * (self.ball + self.shape), _VALLEY_APART * self.valley) / _UNIT

        def cost(u: Array) -> tuple[Array, Array]:
            squared, slope = squared_valleys(u, self.profiles, self.allowed)
            return _SQUARED_VALLEY_COST * squared, _SQUARED_VALLEY_COST * slope

        return blend_layout(distance, self.ball / _UNIT, _VALLEY_COST * self.valley, latent_dim, cost)


def appearance_distances(
    materials: Sequence[MeasuredBRDF], on_progress: Progress | None = None
) -> AppearanceDistances:
    """Compare materials by their balls, by their logarithms, and by the profiles of their blends in cube roots."""
    bands = evenly_spaced(materials[0].bands.count, _BANDS).tolist()
    ball, pairs = ball_colours.ball(), EncodingPairs.default(all_isotropic(materials))
    wi, wo = profile_pairs()
    colours, logs, profiles = [], [], []
    for material in with_progress(materials, on_progress, "appearance"):
        brdf = material.select_bands(bands)
        colours.append(ball.xyz(np.maximum(brdf.eval(ball.wi, ball.wo), 0.0), brdf.bands))
        f = np.maximum(brdf.eval(pairs.wi, pairs.wo), 0.0)
        logs.append((np.log(f + _FLOOR) * np.sqrt(pairs.cosines)[:, None]).ravel())
        profiles.append(np.cbrt(np.maximum(brdf.eval(wi, wo), 0.0)))  # [incidences, directions, B]
    xyz = np.stack(colours)
    white = srgb_to_xyz(np.ones(3))
    difference = np.stack([delta_e_2000(xyz, one[None], white).mean(axis=1) for one in xyz])
    shape = _distances(np.stack(logs))
    upper = np.triu_indices(len(xyz), 1)
    median = np.median(shape[upper])
    if median > 0.0:
        shape *= np.median(difference[upper]) / median
    stacked = np.stack(profiles)
    some = evenly_spaced(stacked.shape[3], _PROFILE_BANDS)
    allowed = np.maximum(valley_depth((stacked**3).mean(axis=3)).max(axis=1), _MEASURED_VALLEY)
    return AppearanceDistances(
        0.5 * (difference + difference.T), shape, _valleys(stacked, allowed), allowed,
        np.ascontiguousarray(stacked[:, :, ::_PROFILE_STRIDE][..., some]),
    )  # fmt: skip


def _valleys(profiles: Array, allowed: Array) -> Array:
    """Depth beyond `allowed` of valleys in blends of every two materials, cube roots (N, I, D, B): shape (N, N)."""
    N = len(profiles)
    deepest = np.zeros((N, N))
    for i in range(1, N):
        for t in _SHARES:
            f = (((1.0 - t) * profiles[i] + t * profiles[:i]) ** 3).mean(axis=3)  # [i, I, D]
            excess = valley_depth(f).max(axis=1) - (1.0 - t) * allowed[i] - t * allowed[:i]
            deepest[i, :i] = np.maximum(deepest[i, :i], excess)
    return np.maximum(deepest, deepest.T)


def _distances(rows: Array) -> Array:
    """Euclidean distances between rows (N, D), shape (N, N)."""
    inner = rows @ rows.T
    squared = np.diag(inner)[:, None] + np.diag(inner)[None] - 2.0 * inner
    return np.sqrt(np.maximum(squared, 0.0))


@dataclass(frozen=True, eq=False)
class BlendTables:
    """Values of N materials, to some or all of which maps of blends are fitted.

    Attributes:
        distances: between the materials.
        bands: which bands are samples, shape (B_s,).
        roots: cube roots of the samples at the appearance pairs, shape (N B_s, P).
        appearance: these pairs.
        sphere, albedo: cube roots of the samples inside integrating spheres, with their measures; see `fit_paths`.
        reflectances: of the materials in all bands, shape (N, B).
    """

    distances: AppearanceDistances
    bands: Indices
    roots: Array
    appearance: AppearancePairs
    sphere: tuple[Array, Array]
    albedo: list[tuple[Array, Array]]
    reflectances: Array

    @classmethod
    def of(
        cls, materials: Sequence[MeasuredBRDF], bands: Indices, on_progress: Progress | None = None
    ) -> BlendTables:
        """Evaluate materials; `bands` (B_s,) become samples."""
        distances = appearance_distances(materials, on_progress)
        samples = [material.select_bands(bands.tolist()) for material in materials]
        appearance = appearance_pairs(all_isotropic(samples))
        pairs, measure = integrating_sphere()
        spheres = [integrating_sphere(degrees) for degrees in _ALBEDO_INCIDENCES_DEG]
        return cls(
            distances, bands, roots_at(samples, appearance.pairs), appearance, (roots_at(samples, pairs), measure),
            [(roots_at(samples, at), measure) for at, measure in spheres],
            np.stack([measure @ material.eval(pairs.wi, pairs.wo) for material in materials]),
        )  # fmt: skip

    def rows(self, materials: Indices) -> Indices:
        """Indices of the samples of materials (n,), shape (n B_s,)."""
        return (materials[:, None] * len(self.bands) + np.arange(len(self.bands))).reshape(-1)

    def subset(self, materials: Indices) -> BlendTables:
        """The tables of some of the materials, (n,) indices."""
        rows, (inside, measure) = self.rows(materials), self.sphere
        return BlendTables(
            self.distances.subset(materials), self.bands, self.roots[rows], self.appearance, (inside[rows], measure),
            [(values[rows], measure) for values, measure in self.albedo], self.reflectances[materials],
        )  # fmt: skip

    def fit(self, latent_dim: int, kernel: Kernel) -> tuple[BlendSpace, Layout]:
        """The map of the materials, and its layout."""
        grid = slice(None, self.appearance.n_grid)
        paths = fit_paths(
            self.roots[:, grid],
            self.appearance.pairs.cosines[grid],
            len(self.bands),
            self.sphere,
            self.albedo,
        )
        layout = self.distances.layout(latent_dim)
        return BlendSpace(layout.X, paths, self.bands, self.reflectances, kernel), layout
