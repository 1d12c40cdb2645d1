"""Maps of blends as a held-out method: laid out from some materials, they encode others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.brdf.measured import all_isotropic
from manifold.experiments.evaluation.method import Encode, Fit
from manifold.experiments.evaluation.tabulated import Data
from manifold.mapping import CubeRoot
from manifold.model.appearance import appearance_pairs, roots_at
from manifold.model.blend_fitting import AppearanceDistances, albedo_samples, appearance_distances
from manifold.model.blend_space import BlendSpace, PlaceSearch
from manifold.model.combination import Combination
from manifold.model.decoding import integrating_sphere
from manifold.models.colour_paths import fit_paths
from manifold.models.kernels import SquaredExponential
from manifold.records import Array


@dataclass(frozen=True, eq=False)
class _Tables:
    """Tables of all materials, of which every fit uses some rows: looks, cube roots of the samples, reflectances.

    Attributes:
        looks: of the materials.
        bands: which bands are samples, among all.
        sphere, albedo: samples inside integrating spheres, with their measures; see `fit_paths`.
        roots: samples at the appearance pairs, shape (N B_s, P).
        reflectances: of the materials in all bands, shape (N, B).
    """

    looks: AppearanceDistances
    bands: Array
    sphere: tuple[Array, Array]
    albedo: list[tuple[Array, Array]]
    roots: Array
    reflectances: Array

    @classmethod
    def of(cls, data: Data, sample_bands: int) -> _Tables:
        """Evaluate the materials behind tabulated values."""
        bands = data.available_bands(sample_bands)
        samples = [material.select_bands(bands.tolist()) for material in data.materials]
        pairs, measure = integrating_sphere()
        reflectances = np.stack([measure @ material.eval(pairs.wi, pairs.wo) for material in data.materials])
        return cls(
            appearance_distances(data.materials), bands, (roots_at(samples, pairs), measure), albedo_samples(samples),
            roots_at(samples, appearance_pairs(all_isotropic(samples)).pairs), reflectances,
        )  # fmt: skip


def fit_blend(latent_dim: int, sample_bands: int = 5) -> Fit:
    """The map of blends: the place, and a path coordinate and a gain per band, by cube roots of values and of a ball's.

    Args:
        latent_dim: Q; fewer where there are not enough materials.
        sample_bands: bands per material that colour paths are made of.
    """

    def fit(data: Data, training: Array) -> Encode:
        tables: _Tables = data.once(("blend", sample_bands), lambda: _Tables.of(data, sample_bands))
        B, appearance = len(tables.bands), appearance_pairs(all_isotropic(data.materials))
        rows = (training[:, None] * B + np.arange(B)).reshape(-1)
        roots, n_grid = tables.roots[rows], appearance.n_grid
        paths = fit_paths(
            roots[:, :n_grid], appearance.pairs.cosines[:n_grid], B, (tables.sphere[0][rows], tables.sphere[1]),
            [(values[rows], measure) for values, measure in tables.albedo],
        )  # fmt: skip
        X = tables.looks.subset(training).layout(min(latent_dim, len(training) - 1)).X
        space = BlendSpace(X, paths, tables.bands, tables.reflectances[training], SquaredExponential())
        search = PlaceSearch(space, roots, appearance.weight(roots))

        def encode(i: int) -> Combination:
            target = roots_at([data.materials[i]], appearance.pairs)
            x, colours = search.find(target, tables.bands)
            spread = np.zeros((data.n_bands, data.n_materials * B))
            spread[:, rows] = space.weights(x, colours)
            return Combination(CubeRoot(), spread, tables.bands)

        return encode

    return fit
