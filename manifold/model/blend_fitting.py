"""Maps of blends fitted to materials: a layout by differences in appearance, and colour paths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.plausibility import (
    LAYOUT_AZIMUTHS_DEG,
    profile_pairs,
    squared_valleys,
    squared_valleys_of_some,
    valley_depth,
)
from manifold.colour import ball_colours, panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000_lab, to_lab
from manifold.core import progress
from manifold.core.records import Array, Indices, evenly_spaced
from manifold.gp.encoding import encoding_pairs
from manifold.gp.kernels import Kernel
from manifold.model.blend_space import BlendSpace
from manifold.model.blending import Layout, blend_layout
from manifold.model.colour_paths import ColourPaths, fit_paths, sample_rows
from manifold.model.decoding import OF_BALL, appearance_weight, integrating_sphere, roots_at
from manifold.model.landmarks import SIGNATURE, Comparison, farthest_samples, landmark_layout, signatures

_BANDS = 12  # bands in which materials are compared, evenly spaced
_FLOOR = 1e-2  # 1/sr, added before logarithms: smaller values look black
_UNIT = 20.0  # CIEDE2000 of the ball per unit of distance, before the layout is scaled
# Depth allowed in all blends: few measured materials have a deeper valley; where one has, blends with it may.
_MEASURED_VALLEY = 0.08
_VALLEY_APART = 300.0  # CIEDE2000 between two materials per depth of the valley in their blend, added
_VALLEY_COST = 10.0  # weight of valleys in blends of two, against stress
_SQUARED_VALLEY_COST = 6000.0  # weight of squared depths in blends of several, against stress
_PROFILE_BANDS, _PROFILE_STRIDE = 4, 2  # bands and stride of directions, of profiles of blends of several
_ALBEDO_INCIDENCES_DEG = (0.0, 30.0, 60.0, 75.0)
_SHARES = (0.2, 0.5, 0.8)  # shares of the first material, in the blends of two that are evaluated


Floats = NDArray[np.float32]  # single precision: there are thousands of materials
Halves = NDArray[np.float16]  # cube roots to 0.05 %, which no colour difference shows


@dataclass(frozen=True, eq=False)
class Appearance:
    """The values by which N materials are compared.

    Attributes:
        lab: CIELAB of the pixels of their balls, shape (N, K, 3).
        logs: logarithms of their values, weighted, shape (N, D).
        profiles: cube roots in the plane of incidence near the mirror direction, shape (N, I, D', B).
        allowed: depth of minima of these profiles that blends with a material may have, shape (N,).
    """

    lab: Array
    logs: Floats
    profiles: Array
    allowed: Array

    def __len__(self) -> int:
        return len(self.lab)

    def subset(self, materials: Indices) -> Appearance:
        """Return the values of some of the materials."""
        return Appearance(*(values[materials] for values in vars(self).values()))

    @property
    def coarse_profiles(self) -> Array:
        """Profiles in every other direction and few bands, for blends of several, shape (N, I, D'', B')."""
        some = evenly_spaced(self.profiles.shape[3], _PROFILE_BANDS)
        return np.ascontiguousarray(self.profiles[:, :, ::_PROFILE_STRIDE][..., some])

    def compare(self, i: int, others: Indices) -> Array:
        """Return the differences of material i from others (n,), shape (3, n).

        Mean CIEDE2000 between their balls, the distance of their logarithms, and the depth, beyond what is allowed, of
        the deepest valley in blends of the two.
        """
        ball = delta_e_2000_lab(self.lab[others], self.lab[i]).mean(axis=1)
        apart = self.logs[others].astype(np.float64) - self.logs[i]
        valley = np.zeros(len(others))
        for t in _SHARES:
            f = (((1.0 - t) * self.profiles[i] + t * self.profiles[others]) ** 3).mean(axis=3)  # [n, I, D']
            excess = valley_depth(f).max(axis=1) - (1.0 - t) * self.allowed[i] - t * self.allowed[others]
            valley = np.maximum(valley, excess)
        return np.stack([ball, np.sqrt(np.einsum("nd,nd->n", apart, apart)), valley])

    def distances(self) -> AppearanceDistances:
        """Return the differences of all pairs."""
        N = len(self)
        found = np.zeros((3, N, N))
        for i in range(1, N):
            found[:, i, :i] = self.compare(i, np.arange(i))
        ball, shape, valley = found + found.transpose(0, 2, 1)
        upper = np.triu_indices(N, 1)
        median = np.median(shape[upper])
        scale = float(np.median(ball[upper]) / median) if median > 0.0 else 1.0
        return AppearanceDistances(ball, scale * shape, valley, self.allowed, self.coarse_profiles, scale)


def _targets(ball: Array, shape: Array, valley: Array) -> tuple[Array, Array]:
    """Return target and least distances on a map."""
    return np.hypot(0.5 * (ball + shape), _VALLEY_APART * valley) / _UNIT, ball / _UNIT


@dataclass(frozen=True, eq=False)
class AppearanceDistances:
    """Appearance distances between N materials.

    Attributes:
        ball: mean CIEDE2000 between their balls, shape (N, N).
        shape: distance of their logarithms, scaled to the median of `ball`, shape (N, N).
        valley: depth of in-plane minima near the mirror direction in blends of two, beyond `allowed`, shape (N, N).
        allowed: depth of such minima that blends with a material may have, shape (N,).
        profiles: cube roots in the plane of incidence near the mirror direction, shape (N, I, D, B).
        scale: of `shape`: what distances of logarithms were multiplied by.
    """

    ball: Array
    shape: Array
    valley: Array
    allowed: Array
    profiles: Array
    scale: float

    def subset(self, materials: Indices) -> AppearanceDistances:
        """Return the distances between some of the materials."""
        rows = np.ix_(materials, materials)
        return AppearanceDistances(
            self.ball[rows], self.shape[rows], self.valley[rows], self.allowed[materials],
            self.profiles[materials], self.scale,
        )  # fmt: skip

    def layout(self, latent_dim: int) -> Layout:
        """Return the places of the materials in Q dimensions, in units of the kernel's length scale."""

        def cost(u: Array) -> tuple[Array, Array]:
            squared, slope = squared_valleys(u, self.profiles, self.allowed)
            return _SQUARED_VALLEY_COST * squared, _SQUARED_VALLEY_COST * slope

        distance, separation = _targets(self.ball, self.shape, self.valley)
        return blend_layout(distance, separation, _VALLEY_COST * self.valley, latent_dim, cost)


@dataclass(frozen=True, eq=False)
class BlendSamples:
    """Values of N materials in the bands that colour paths are made of.

    Attributes:
        bands: which bands are samples, shape (B_s,).
        roots: cube roots of the samples at the appearance pairs, shape (N B_s, P).
        on_ball: cube roots of the samples at all pairs of the ball in the judged lights, shape (N B_s, P').
        sphere, albedo: cube roots of the samples inside integrating spheres, with their measures; see `fit_paths`.
        reflectances: of the materials in all bands, shape (N, B).
    """

    bands: Indices
    roots: Floats
    on_ball: Halves
    sphere: tuple[Floats, Array]
    albedo: list[tuple[Floats, Array]]
    reflectances: Array

    def rows(self, materials: Indices) -> Indices:
        """Return the indices of the samples of materials (n,), shape (n B_s,)."""
        return sample_rows(materials, len(self.bands))

    def subset(self, materials: Indices) -> BlendSamples:
        """Return the samples of some of the materials, (n,) indices."""
        rows, (inside, measure) = self.rows(materials), self.sphere
        albedo = [(values[rows], measure) for values, measure in self.albedo]
        return BlendSamples(
            self.bands,
            self.roots[rows],
            self.on_ball[rows],
            (inside[rows], measure),
            albedo,
            self.reflectances[materials],
        )

    def paths(self, landmarks: Indices | None = None) -> ColourPaths:
        """Return colour paths made of a material's own samples and those of landmarks, by default of all materials."""
        cosines = encoding_pairs().cosines
        return fit_paths(
            self.roots[:, : len(cosines)], cosines, len(self.bands), self.sphere, self.albedo, landmarks
        )


def evaluate(
    materials: Iterable[MeasuredBRDF], bands: Indices, is_isotropic: bool
) -> tuple[Appearance, BlendSamples]:
    """Return the values to which maps of blends are fitted, from one material after another.

    `bands` (B_s,) become samples.
    """
    ball, white, grid = ball_colours.ball(), srgb_to_xyz(np.ones(3)), encoding_pairs(is_isotropic)
    lights = panel.judged()
    wi_wo = profile_pairs() if is_isotropic else profile_pairs(azimuths_deg=LAYOUT_AZIMUTHS_DEG)
    spheres = [integrating_sphere(), *(integrating_sphere(degrees) for degrees in _ALBEDO_INCIDENCES_DEG)]
    on_ball: list[Halves] = []
    amplitude = np.sqrt(grid.cosines)[:, None]
    looks: list[tuple[Array, Floats, Array]] = []
    roots, inside = list[Floats](), [list[Floats]() for _ in spheres]
    reflectances = []
    for material in materials:
        brdf = material.select_bands(evenly_spaced(material.bands.count, _BANDS).tolist())
        xyz = ball.xyz(np.maximum(values_at(brdf, ball), 0.0), brdf.bands)
        f = np.maximum(values_at(brdf, grid), 0.0)
        profile = np.cbrt(np.maximum(brdf.eval(*wi_wo), 0.0))  # [I, D', B]
        looks.append(
            (to_lab(xyz, white), (np.log(f + _FLOOR) * amplitude).ravel().astype(np.float32), profile)
        )
        sample = material.select_bands(bands.tolist())
        in_grid, lit = (roots_at([sample], pairs).astype(np.float32) for pairs in (grid, lights))
        roots.append(np.hstack([in_grid, lit[:, : len(ball)][:, OF_BALL]]))  # those of the studio come first
        on_ball.append(lit.astype(np.float16))
        for kept, sphere in zip(inside, spheres, strict=True):
            kept.append(roots_at([sample], sphere).astype(np.float32))
        reflectances.append(spheres[0].of(values_at(material, spheres[0]))[0])
    lab, logs, profiles = (np.stack(each) for each in zip(*looks, strict=True))
    allowed = np.maximum(valley_depth((profiles**3).mean(axis=3)).max(axis=1), _MEASURED_VALLEY)
    in_sphere, *albedo = [
        (np.concatenate(values), sphere.light) for values, sphere in zip(inside, spheres, strict=True)
    ]
    samples = BlendSamples(
        bands, np.concatenate(roots), np.concatenate(on_ball), in_sphere, albedo, np.stack(reflectances),
    )  # fmt: skip
    return Appearance(lab, logs, profiles, allowed), samples


@dataclass(frozen=True, eq=False)
class BlendTables:
    """Distances and samples of N materials, to some or all of which maps of blends are fitted."""

    distances: AppearanceDistances
    samples: BlendSamples

    @classmethod
    def of(cls, materials: Sequence[MeasuredBRDF], bands: Indices) -> BlendTables:
        """Evaluate materials; `bands` (B_s,) become samples."""
        read = progress.each(materials, "appearance")
        appearance, samples = evaluate(read, bands, all_isotropic(materials))
        return cls(appearance.distances(), samples)

    def subset(self, materials: Indices) -> BlendTables:
        """Return the tables of some of the materials, (n,) indices."""
        return BlendTables(self.distances.subset(materials), self.samples.subset(materials))

    def fit(self, latent_dim: int, kernel: Kernel) -> tuple[BlendSpace, Layout]:
        """Return the map of the materials, and its layout."""
        layout, s = self.distances.layout(latent_dim), self.samples
        return BlendSpace(layout.X, s.paths(), s.bands, s.reflectances, kernel), layout


def fit_landmarks(
    appearance: Appearance, samples: BlendSamples, count: int, latent_dim: int, kernel: Kernel,
) -> tuple[BlendSpace, Layout]:  # fmt: skip
    """Return the map of N materials by `count` landmarks, and its layout, at a cost linear in N."""
    N, everything = len(appearance), np.arange(len(appearance))
    compared = {}
    scale = appearance.subset(evenly_spaced(N, count)).distances().scale

    def distances_to(landmark: int) -> Array:
        ball, shape, valley = appearance.compare(landmark, everything)
        compared[landmark] = _targets(ball, scale * shape, valley)
        progress.report(len(compared), count, "landmarks")
        return compared[landmark][0]

    landmarks = farthest_samples(count, distances_to)
    distance, separation = (
        np.stack(each, axis=1) for each in zip(*(compared[k] for k in landmarks), strict=True)
    )
    of_landmarks = appearance.subset(landmarks).distances().layout(latent_dim)
    profiles = appearance.coarse_profiles

    def compare(others: Indices) -> Comparison:
        rows = []
        for i, row in progress.each(enumerate(others), "neighbours"):
            ball, shape, valley = appearance.compare(i, row)
            rows.append(_targets(ball, scale * shape, valley))
        return Comparison(others, *(np.stack(each) for each in zip(*rows, strict=True)))

    def cost(u: Array, materials: Indices) -> tuple[Array, Array]:
        squared, slope = squared_valleys_of_some(u, materials, profiles, appearance.allowed)
        return _SQUARED_VALLEY_COST * squared, _SQUARED_VALLEY_COST * slope

    to_landmarks = Comparison(np.broadcast_to(landmarks, distance.shape), distance, separation)
    layout = landmark_layout(landmarks, of_landmarks, to_landmarks, compare, cost)
    s = samples
    space = BlendSpace(
        layout.X, s.paths(landmarks), s.bands, s.reflectances, kernel, landmarks, _signatures(s, landmarks)
    )
    return space, layout


def _signatures(samples: BlendSamples, landmarks: Indices) -> Array:
    """Return coordinates (N, r) of the materials in the span of a few landmarks, for distances of cube roots."""
    weight = appearance_weight(samples.roots[samples.rows(landmarks)]).astype(np.float32)
    rows = (samples.roots * weight).reshape(len(samples.reflectances), -1)
    some = rows[landmarks[:SIGNATURE]]
    return signatures(some @ some.T, rows @ some.T)
