"""Fits maps of blends to materials: a layout by differences in appearance, and colour paths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.interface import all_isotropic
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.plausibility import ALBEDO_INCIDENCES_DEG
from manifold.colour import ball_colours, panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000_lab, to_lab
from manifold.core import progress
from manifold.core.records import Array, Indices, evenly_spaced
from manifold.gp.encoding import encoding_pairs
from manifold.gp.kernels import Kernel
from manifold.model.blend_space import BlendSpace
from manifold.model.blending import blend_layout, scaled
from manifold.model.colour_paths import ColourPaths, fit_paths, sample_rows
from manifold.model.decoding import OF_BALL, appearance_weight, integrating_sphere, roots_at
from manifold.model.landmarks import SIGNATURE, farthest_samples, landmark_layout, signatures
from manifold.model.settings import COMPARED_BANDS

_FLOOR = 1e-2  # 1/sr, added before logarithms: smaller values look black
_BALL = 0.85  # share of the balls in the distance of two materials; the rest is that of the logarithms


Floats = NDArray[np.float32]  # single precision: there are thousands of materials
Halves = NDArray[np.float16]  # cube roots to 0.05 %, which no colour difference shows


@dataclass(frozen=True, eq=False)
class Appearance:
    """The values by which N materials are compared.

    Attributes:
        lab: CIELAB values of the pixels of balls in the lights used for fitting, shape (N, K, 3).
        logs: weighted logarithms of the BRDF values, shape (N, D).
    """

    lab: Array
    logs: Floats

    def __len__(self) -> int:
        return len(self.lab)

    def subset(self, materials: Indices) -> Appearance:
        """Return the values of some of the materials, given their indices (n,)."""
        return Appearance(self.lab[materials], self.logs[materials])

    @property
    def lightness(self) -> Array:
        """Return the mean CIELAB lightness of the balls, shape (N,)."""
        return np.asarray(self.lab[..., 0] @ panel.fitted_pixels().pixel_weights / self.lab.shape[1])

    def compare(self, i: int, others: Indices) -> Array:
        """Return the differences of material i from others (n,), shape (2, n).

        The rows are the mean CIEDE2000 between the balls, and the distance between the logarithms.
        """
        ball = (
            delta_e_2000_lab(self.lab[others], self.lab[i])
            @ panel.fitted_pixels().pixel_weights
            / self.lab.shape[1]
        )
        apart = self.logs[others].astype(np.float64) - self.logs[i]
        return np.stack([ball, np.sqrt(np.einsum("nd,nd->n", apart, apart))])

    def distances(self) -> AppearanceDistances:
        """Return the differences between all pairs of materials."""
        N = len(self)
        found = np.zeros((2, N, N))
        for i in range(1, N):
            found[:, i, :i] = self.compare(i, np.arange(i))
        ball, shape = found + found.transpose(0, 2, 1)
        return AppearanceDistances.of(ball, shape, self.lightness)


def _mixed(ball: Array, shape: Array) -> Array:
    """Return the distances of a layout."""
    return _BALL * ball + (1.0 - _BALL) * shape


@dataclass(frozen=True, eq=False)
class AppearanceDistances:
    """Appearance distances between N materials.

    Attributes:
        ball: mean CIEDE2000 between the balls, shape (N, N).
        shape: distance between the logarithms of the values, scaled to the median of `ball`, shape (N, N).
        lightness: mean CIELAB lightness of the balls, shape (N,).
        scale: factor by which distances of logarithms were multiplied to get `shape`.
    """

    ball: Array
    shape: Array
    lightness: Array
    scale: float

    @classmethod
    def of(cls, ball: Array, shape: Array, lightness: Array, scale: float = 1.0) -> AppearanceDistances:
        """Scale distances of logarithms, already multiplied by `scale`, to the median of those of the balls."""
        upper = np.triu_indices(len(ball), 1)
        median = np.median(shape[upper])
        more = float(np.median(ball[upper]) / median) if median > 0.0 else 1.0
        return cls(ball, more * shape, lightness, scale * more)

    def subset(self, materials: Indices) -> AppearanceDistances:
        """Return the distances between some of the materials, given their indices (n,)."""
        rows = np.ix_(materials, materials)
        return AppearanceDistances.of(
            self.ball[rows], self.shape[rows], self.lightness[materials], self.scale
        )

    def layout(self, latent_dim: int) -> Array:
        """Return positions (N, Q) of the materials on a map of Q dimensions, in length scales of the kernel."""
        return scaled(blend_layout(_mixed(self.ball, self.shape), latent_dim), self.lightness)


@dataclass(frozen=True, eq=False)
class BlendSamples:
    """Samples of N materials: their values in the B_s bands from which colour paths are made.

    Attributes:
        bands: indices of the bands that are samples, shape (B_s,).
        roots: cube roots of the samples at the appearance pairs, shape (N B_s, P).
        on_ball: cube roots of the samples at the direction pairs of balls in the five test lights, shape (N B_s,
            P').
        ball, albedo: cube roots of the samples inside integrating spheres, with their measures; see `fit_paths`.
        reflectances: reflectances of the materials in all bands, shape (N, B).
    """

    bands: Indices
    roots: Floats
    on_ball: Halves
    sphere: tuple[Floats, Array]
    albedo: list[tuple[Floats, Array]]
    reflectances: Array

    def rows(self, materials: Indices) -> Indices:
        """Return the row indices of the samples of materials (n,), shape (n B_s,)."""
        return sample_rows(materials, len(self.bands))

    def subset(self, materials: Indices) -> BlendSamples:
        """Return the samples of some of the materials, given their indices (n,)."""
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
        """Return colour paths made of a material's own samples and those of the landmarks, by default all materials."""
        cosines = encoding_pairs().cosines
        return fit_paths(
            self.roots[:, : len(cosines)], cosines, len(self.bands), self.sphere, self.albedo, landmarks
        )


def evaluate(
    materials: Iterable[MeasuredBRDF], bands: Indices, is_isotropic: bool
) -> tuple[Appearance, BlendSamples]:
    """Return the values to which a map of blends is fitted; materials are read one after another.

    `bands` (B_s,) are the indices of the bands that become samples.
    """
    white, grid, looks, lights = (
        srgb_to_xyz(np.ones(3)),
        encoding_pairs(is_isotropic),
        panel.fitted_pixels(),
        panel.judged(),
    )
    studio = len(ball_colours.ball())
    spheres = [integrating_sphere(), *(integrating_sphere(degrees) for degrees in ALBEDO_INCIDENCES_DEG)]
    on_ball: list[Halves] = []
    amplitude = np.sqrt(grid.cosines)[:, None]
    appearances: list[tuple[Array, Floats]] = []
    roots, inside = list[Floats](), [list[Floats]() for _ in spheres]
    reflectances = []
    for material in materials:
        brdf = material.select_bands(evenly_spaced(material.bands.count, COMPARED_BANDS).tolist())
        xyz = looks.xyz(np.maximum(values_at(brdf, looks), 0.0), brdf.bands)
        f = np.maximum(values_at(brdf, grid), 0.0)
        appearances.append((to_lab(xyz, white), (np.log(f + _FLOOR) * amplitude).ravel().astype(np.float32)))
        sample = material.select_bands(bands.tolist())
        in_grid, lit = (roots_at([sample], pairs).astype(np.float32) for pairs in (grid, lights))
        roots.append(np.hstack([in_grid, lit[:, :studio][:, OF_BALL]]))  # those of the studio come first
        on_ball.append(lit.astype(np.float16))
        for kept, sphere in zip(inside, spheres, strict=True):
            kept.append(roots_at([sample], sphere).astype(np.float32))
        reflectances.append(spheres[0].of(values_at(material, spheres[0]))[0])
    lab, logs = (np.stack(each) for each in zip(*appearances, strict=True))
    in_sphere, *albedo = [
        (np.concatenate(values), sphere.light) for values, sphere in zip(inside, spheres, strict=True)
    ]
    samples = BlendSamples(
        bands, np.concatenate(roots), np.concatenate(on_ball), in_sphere, albedo, np.stack(reflectances),
    )  # fmt: skip
    return Appearance(lab, logs), samples


@dataclass(frozen=True, eq=False)
class BlendTables:
    """Distances and samples of N materials, for fitting maps of blends to all or some of them."""

    distances: AppearanceDistances
    samples: BlendSamples

    @classmethod
    def of(cls, materials: Sequence[MeasuredBRDF], bands: Indices) -> BlendTables:
        """Evaluate the distances and samples of materials.

        `bands` (B_s,) are the indices of the bands that become samples.
        """
        read = progress.each(materials, "appearance")
        appearance, samples = evaluate(read, bands, all_isotropic(materials))
        return cls(appearance.distances(), samples)

    def subset(self, materials: Indices) -> BlendTables:
        """Return the tables of some of the materials, given their indices (n,)."""
        return BlendTables(self.distances.subset(materials), self.samples.subset(materials))

    def fit(self, latent_dim: int, kernel: Kernel) -> BlendSpace:
        """Fit a map of `latent_dim` dimensions to the materials and return it."""
        s = self.samples
        return BlendSpace(self.distances.layout(latent_dim), s.paths(), s.bands, s.reflectances, kernel)


def fit_landmarks(
    appearance: Appearance, samples: BlendSamples, count: int, latent_dim: int, kernel: Kernel,
) -> BlendSpace:  # fmt: skip
    """Fit a map to N materials through `count` landmarks; the number of comparisons of materials is linear in N."""
    N, everything = len(appearance), np.arange(len(appearance))
    compared = {}
    scale = appearance.subset(evenly_spaced(N, count)).distances().scale

    def distances_to(landmark: int) -> Array:
        ball, shape = appearance.compare(landmark, everything)
        compared[landmark] = _mixed(ball, scale * shape)
        progress.report(len(compared), count, "landmarks")
        return compared[landmark]

    landmarks = farthest_samples(count, distances_to)
    distance = np.stack([compared[k] for k in landmarks], axis=1)
    anchors = blend_layout(distance[landmarks], latent_dim)

    def compare(others: Indices) -> Array:
        rows = []
        for i, row in progress.each(enumerate(others), "neighbours"):
            ball, shape = appearance.compare(i, row)
            rows.append(_mixed(ball, scale * shape))
        return np.stack(rows)

    X = scaled(landmark_layout(landmarks, anchors, distance, compare), appearance.lightness)
    s = samples
    return BlendSpace(
        X, s.paths(landmarks), s.bands, s.reflectances, kernel, landmarks, _signatures(s, landmarks)
    )


def _signatures(samples: BlendSamples, landmarks: Indices) -> Array:
    """Return coordinates (N, r) of the materials in the span of a few landmarks, for distances of cube roots."""
    weight = appearance_weight(samples.roots[samples.rows(landmarks)]).astype(np.float32)
    rows = (samples.roots * weight).reshape(len(samples.reflectances), -1)
    some = rows[landmarks[:SIGNATURE]]
    return signatures(some @ some.T, rows @ some.T)
