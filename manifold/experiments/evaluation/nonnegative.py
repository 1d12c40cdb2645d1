"""Combinations of samples and analytic lobes with weights >= 0, as methods; see docs/design/nonnegative.md."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from manifold.colour.conversion import to_xyz
from manifold.experiments.evaluation.method import Encode, Fit
from manifold.experiments.evaluation.samples import Samples
from manifold.experiments.evaluation.tabulated import Data
from manifold.mapping import CubeRoot
from manifold.model.combination import Combination
from manifold.models.dictionary import Dictionary
from manifold.models.picture_terms import picture_rows
from manifold.models.reconstruction_weights import reconstruction_weights
from manifold.models.shared_pair import shared_pair
from manifold.records import Array, Bands

NUMBERS_PER_BAND = 18  # of a reconstruction: about nine weights and which atoms they are of; none is fixed
PAIR_EXPONENTS = (1.0, 0.6, 0.8, 1.25, 1.5)  # two atoms alone need shapes that no sample has


@dataclass(frozen=True, eq=False)
class _Atoms:
    """Atoms that samples of the training materials and lobes make, at the direction pairs that serve to encode.

    Attributes:
        samples: of all materials.
        dictionary: of atoms.
        columns: where the atoms of the training materials, and lobes, stand among those of all, shape (n,).
        roots: cube roots of f, shape (n, P_s).
        cosines: shape (P_s,).
        rows: averages over groups of the pairs, (K, P_s).
    """

    samples: Samples
    dictionary: Dictionary
    columns: Array
    roots: Array
    cosines: Array
    rows: csr_matrix

    @classmethod
    def of(cls, data: Data, training: Array, dictionary: Dictionary, sample_bands: int) -> _Atoms:
        """Map the values that training materials have in sample bands."""
        samples, some = (
            Samples(data, CubeRoot(), data.available_bands(sample_bands)),
            slice(None, None, data.stride),
        )
        n_samples, used = samples.group * data.n_materials, samples.rows(training)
        powers = [k * n_samples + used for k in range(len(dictionary.exponents))]
        lobes = np.arange(n_samples * len(powers), dictionary.size(n_samples))
        wi, wo = data.wi[some], data.wo[some]
        roots = dictionary.atoms(
            data.samples(samples.mapping, samples.bands)[used, some], dictionary.lobes.cube_roots(wi, wo)
        )
        return cls(
            samples, dictionary, np.concatenate([*powers, lobes]), np.ascontiguousarray(roots), data.cosines[some],
            picture_rows(wi, wo),
        )  # fmt: skip

    @property
    def lambertian(self) -> int:
        """Index of the first lobe, the Lambertian."""
        return len(self.columns) - len(self.dictionary.lobes)

    def combination(self, weights: Array) -> Combination:
        """The prediction by weights (B, n)."""
        n_samples = self.samples.group * self.samples.data.n_materials
        spread = np.zeros((len(weights), self.dictionary.size(n_samples)))
        spread[:, self.columns] = weights
        return Combination(CubeRoot(), spread, self.samples.bands, dictionary=self.dictionary)


def fit_nonnegative(sample_bands: int, picture: float = 1.0) -> Fit:
    """All samples and lobes, as many as it takes: see `reconstruction_weights`.

    Args:
        sample_bands: bands per material that are samples.
        picture: weight of what a picture sees; 0 leaves cube-root errors alone.
    """

    def fit(data: Data, training: Array) -> Encode:
        atoms = _Atoms.of(data, training, Dictionary(), sample_bands)

        def encode(i: int) -> Combination:
            targets = np.cbrt(data.full_values(i).T)
            return atoms.combination(
                reconstruction_weights(atoms.roots, targets, atoms.cosines, atoms.rows, picture=picture)
            )

        return encode

    return fit


def fit_nonnegative_pair(sample_bands: int) -> Fit:
    """Two atoms that all bands share, and a white Lambertian: see `shared_pair`.

    They are found in the data's bands; weights between these are linear.
    """

    def fit(data: Data, training: Array) -> Encode:
        atoms = _Atoms.of(data, training, Dictionary(PAIR_EXPONENTS), sample_bands)
        axis = (data.materials[0].bands if data.materials else Bands(None)).select(data.bands)
        unit = np.array([to_xyz(row, axis) for row in np.eye(axis.count)]).T

        def encode(i: int) -> Combination:
            targets = np.cbrt(data.f[i, :: data.stride].T)
            nodes = shared_pair(atoms.roots, atoms.lambertian, targets, atoms.cosines, atoms.rows, unit)
            used = np.flatnonzero(nodes.any(axis=0))
            weights = np.zeros((data.n_bands, nodes.shape[1]))
            weights[:, used] = data.interpolated(nodes[:, used])
            return atoms.combination(weights)

        return encode

    return fit
