"""What photographs are explained by: a library's bands and their roots, dielectric coats, and microfacet lobes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.colour import panel
from manifold.estimate.atoms import LibraryAtoms
from manifold.mapping import Identity
from manifold.model.combination import Combination
from manifold.model.prediction import PredictedBRDF
from manifold.model.reconstruction import DICTIONARY
from manifold.records import Array, Bands, Indices, Mask

_LOBES = DICTIONARY.lobes


@dataclass(frozen=True, eq=False)
class PhotoAtoms:
    """BRDFs whose non-negative sums explain photographs, all in one band.

    They are the library's materials and coats, band by band; roots of the library's bands, which have broader lobes;
    and a Lambertian and lobes with free Fresnel terms, see `latent.lobes`: colours that change with incidence, such as
    those of iridescent paints, are in no other.

    Attributes:
        library: materials and coats.
    """

    library: LibraryAtoms

    def __len__(self) -> int:
        return len(self.material_of)

    @cached_property
    def material_of(self) -> Indices:
        """Index of each atom's material or coat, that of the Lambertian and lobes being N: shape (n,)."""
        own = self.library.material_of[:-1]
        roots = np.tile(own[: self.library.n_measured], len(DICTIONARY.exponents) - 1)
        return np.concatenate([own, roots, np.full(len(_LOBES), own[-1] + 1)])

    @property
    def mixed(self) -> Indices:
        """Atoms whose mixtures are the prior: materials and coats, then the Lambertian."""
        n = len(self.library.material_of) - 1
        return np.append(np.arange(n), len(self) - len(_LOBES))

    def without(self, material: int) -> Mask:
        """Which atoms are left without one material of the library."""
        return self.material_of != material

    def values(self, wi: Array, wo: Array) -> Array:
        """f of all atoms in 1/sr at direction pairs (P, 3), shape (n, P)."""
        return self._from_roots(self.library.at(wi, wo), wi, wo)

    def _from_roots(self, roots: Array, wi: Array, wo: Array) -> Array:
        measured = roots[: self.library.n_measured]
        powers = [measured ** (3.0 * exponent) for exponent in DICTIONARY.exponents[1:]]
        return np.vstack([roots[:-1] ** 3, *powers, _LOBES.values(wi, wo)])

    @cached_property
    def on_grid(self) -> Array:
        """f times both cosines at the encoding grid, shape (n, P_g)."""
        grid, n = self.library.grid, self.library.n_grid
        return self._from_roots(self.library.directions[:, :n], grid.wi, grid.wo) * grid.cosines

    @cached_property
    def on_ball(self) -> Array:
        """Pixels of a ball in the judged lights, shape (n, K)."""
        lights = panel.judged()
        return lights.pixels(self._from_roots(self.library.ball, lights.wi, lights.wo))

    def predicted(self, weights: Array, bands: Bands) -> PredictedBRDF:
        """The BRDF of weights (B, n) of atoms in some bands."""
        n, measured = len(self.library.material_of) - 1, self.library.n_measured
        roots = len(DICTIONARY.exponents) - 1
        columns = [weights[:, :n]]
        for k in range(roots):
            part = weights[:, n + k * measured : n + (k + 1) * measured]
            columns.append(np.hstack([part, np.zeros((len(weights), n - measured))]))
        columns.append(weights[:, n + roots * measured :])
        combination = Combination(
            Identity(), np.hstack(columns), self.library.atom_bands, dictionary=DICTIONARY
        )
        return PredictedBRDF(self.library.materials, combination, bands)
