"""The atoms of completion: cube roots of single bands of a library's materials, dielectric coats, and a Lambertian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from manifold.analytic.free_lobes import Lobes
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf.measured import BRDF, all_isotropic
from manifold.colour import panel
from manifold.encoding import EncodingPairs
from manifold.errors import UsageError
from manifold.estimate.gloss import gloss_meter
from manifold.estimate.residual import coordinates
from manifold.library.store import Library
from manifold.mapping import CubeRoot
from manifold.model.appearance import roots_at
from manifold.model.combination import Combination
from manifold.model.dictionary import Dictionary
from manifold.model.materials import MaterialCache
from manifold.model.prediction import PredictedBRDF
from manifold.names import counted
from manifold.records import Array, Bands, Indices, Mask, evenly_spaced

MOST_MATERIALS = 1000
"""Of a library from which readings are completed: each is left out once, against all others."""

ATOM_BANDS = 5  # of a spectral material; more gain nothing
COAT_ALPHAS = tuple(np.geomspace(0.015, 0.26, 10).tolist())  # duller ones replace measured matt materials
COAT_INDICES = (1.42, 1.58)
_COAT_BASE = 0.9  # largest reflectance of what is below a coat
_LEAST_COAT = 0.05  # mean prior weight from which a coat is fitted to the readings
LAMBERTIAN = Dictionary(lobes=Lobes((), ()))
"""The only analytic lobe among the atoms."""
_MOST_SHOWN, _LEAST_SHOWN = 6, 0.005  # materials of a mixture, and share of all of one
_BALL_STRIDE = 7  # one in this many of a ball's direction pairs is used


@cache
def ball_coordinates() -> Array:
    """Coordinates of the pairs that light a ball in the judged lights, see `residual.coordinates`."""
    lights = panel.judged()
    return coordinates(lights.wi, lights.wo)


@cache
def grid_coordinates() -> Array:
    """Coordinates of the encoding grid, whatever the azimuths of its half vectors, see `residual.coordinates`."""
    grid = EncodingPairs.default()
    return coordinates(grid.wi, grid.wo)


def shown_shares(names: Sequence[str], weights: Array) -> tuple[tuple[str, float], ...]:
    """The materials of a mixture that are shown, with their weights (N,), largest first; one without any is black."""
    order = np.argsort(-weights, kind="stable")[:_MOST_SHOWN]
    shown = tuple((names[m], float(weights[m])) for m in order if weights[m] > _LEAST_SHOWN * weights.sum())
    return shown or (("black", 1.0),)


@dataclass(frozen=True, eq=False)
class LibraryAtoms:
    """Cube roots of n atoms and, last, of a Lambertian on a grid of all directions and on a ball.

    Attributes:
        names: of the materials of the library, n of N.
        coats: names of the other materials: dielectric coats, see `dielectric_coats`.
        bands: of the library.
        atom_bands: which of them are atoms, shape (B_s,); atom m * B_s + s is band s of material m.
        materials: N, in these bands alone.
        directions: cube roots at the encoding grid, then at some pairs that light a ball, shape (n + 1, P).
        weights: of these pairs; grid and ball have the same energy, shape (P,).
        grid: the encoding grid.
        ball: cube roots at all pairs that light a ball in the judged lights, shape (n + 1, P_b).
    """

    names: tuple[str, ...]
    coats: tuple[str, ...]
    bands: Bands
    atom_bands: Indices
    materials: Sequence[BRDF]
    directions: Array
    weights: Array
    grid: EncodingPairs
    ball: Array

    @classmethod
    def of_library(cls, library: Library) -> LibraryAtoms:
        """Evaluate all materials of a library, negative values taken for 0.

        Raises:
            UsageError: there are fewer than three, or more than `MOST_MATERIALS`.
            LibraryError: a material cannot be read.
        """
        names, bands = library.names, library.bands
        if len(names) < 3:
            raise UsageError(
                f"{library.path}: {counted(len(names), 'material')}, expected at least three to complete readings "
                "from; import more"
            )
        if len(names) > MOST_MATERIALS:
            raise UsageError(
                f"{library.path}: {len(names)} materials, expected at most {MOST_MATERIALS} to complete readings from; "
                "import those that are like the sample into a library of their own"
            )
        chosen = evenly_spaced(bands.count, ATOM_BANDS)
        cache = MaterialCache(library, names, is_nonnegative=True)
        coats = dielectric_coats(bands.select(chosen))
        materials: list[BRDF] = [*cache.in_bands(chosen.tolist()), *coats.values()]
        grid, lights = EncodingPairs.default(all_isotropic(materials)), panel.judged()
        on_grid, on_ball = (_roots_at(materials, pairs.wi, pairs.wo) for pairs in (grid, lights))
        ball = lights.balls[0]  # in the studio
        some = slice(None, len(ball.wi), _BALL_STRIDE)
        of_grid, of_ball = grid.cosines ** (2.0 / 3.0), ball.light[::_BALL_STRIDE] ** (2.0 / 3.0)
        energy = [
            float(np.sum(roots**2 @ weights))
            for roots, weights in ((on_grid, of_grid), (on_ball[:, some], of_ball))
        ]
        of_ball = of_ball * energy[0] / max(energy[1], np.finfo(float).tiny)
        return cls(
            names, tuple(coats), bands, chosen, materials, np.hstack([on_grid, on_ball[:, some]]),
            np.concatenate([of_grid, of_ball]), grid, on_ball,
        )  # fmt: skip

    @property
    def n_grid(self) -> int:
        """How many pairs are the grid's."""
        return len(self.grid.wi)

    @property
    def band_axis(self) -> Bands:
        """The spectral axis of the atoms of one material."""
        return self.bands.select(self.atom_bands)

    @cached_property
    def material_of(self) -> Indices:
        """Index of each atom's material, shape (n + 1,); the Lambertian's is N."""
        N = len(self.materials)
        return np.append(np.repeat(np.arange(N), len(self.atom_bands)), N)

    @cached_property
    def gram(self) -> Array:
        """Inner products of atoms, averaged over the grid, shape (n + 1, n + 1)."""
        roots, weights = self.directions[:, : self.n_grid], self.weights[: self.n_grid]
        return (roots * weights) @ roots.T / self.n_grid

    @property
    def n_measured(self) -> int:
        """How many atoms, the first ones, are of materials of the library."""
        return len(self.names) * len(self.atom_bands)

    def usable(self, prior: Array) -> Mask:
        """Which are atoms of the library, of coats of some prior weight (B, n + 1), or the Lambertian: (n + 1,)."""
        totals = np.bincount(self.material_of, prior.mean(axis=0))
        totals[: len(self.names)] = totals[-1] = np.inf
        return np.asarray(totals[self.material_of] > _LEAST_COAT)

    def without(self, material: int) -> LibraryAtoms:
        """The atoms of all materials but one of the library."""
        rows = np.flatnonzero(self.material_of != material)
        left = replace(
            self,
            names=tuple(name for m, name in enumerate(self.names) if m != material),
            materials=[brdf for m, brdf in enumerate(self.materials) if m != material],
            directions=self.directions[rows],
            ball=self.ball[rows],
        )
        left.__dict__["gram"] = self.gram[np.ix_(rows, rows)]
        return left

    def in_atom_bands(self) -> LibraryAtoms:
        """The same atoms, of a library that has their bands only."""
        same = replace(self, bands=self.band_axis)
        same.__dict__["gram"] = self.gram
        return same

    def at(self, wi: Array, wo: Array) -> Array:
        """Cube roots of atoms and Lambertian at direction pairs (P, 3), shape (n + 1, P)."""
        return _roots_at(self.materials, wi, wo)

    def gloss(self, angles_deg: Sequence[float]) -> Array:
        """Cube roots of their means over the apertures of gloss meters at G angles, shape (n + 1, G)."""
        roots = np.empty((len(self.material_of), len(angles_deg)))
        for k, meter in enumerate(map(gloss_meter, angles_deg)):
            roots[:, k] = np.cbrt(meter.mean(self.at(meter.wi, meter.wo).T ** 3))
        return roots

    def predicted(self, weights: Array, bands: Bands | None = None) -> PredictedBRDF:
        """The BRDF of weights (B, n + 1) of atoms in some bands, those of the library by default."""
        combination = Combination(CubeRoot(), weights, self.atom_bands, dictionary=LAMBERTIAN)
        return PredictedBRDF(self.materials, combination, bands or self.bands)


def dielectric_coats(bands: Bands) -> dict[str, Plastic]:
    """Rough dielectrics over a diffuse base by name, from sharp to dull; their bands differ in the base alone.

    A mixture of the bands of one has a base of any colour under the highlight that Fresnel's equations give.
    """
    bases = np.linspace(0.0, np.cbrt(_COAT_BASE), bands.count) ** 3
    return {
        f"dielectric coat (alpha {alpha:.2g}, index {eta:g})": Plastic(
            GGX.isotropic(alpha), np.array(eta), bases, bands
        )
        for alpha in COAT_ALPHAS
        for eta in COAT_INDICES
    }


def _roots_at(materials: Sequence[BRDF], wi: Array, wo: Array) -> Array:
    """Cube roots of atoms and, last, of the Lambertian of albedo 1 at direction pairs (P, 3), shape (n + 1, P)."""
    roots = np.ascontiguousarray(roots_at(materials, EncodingPairs(wi, wo)))
    return np.vstack([roots, LAMBERTIAN.lobes.cube_roots(wi, wo)])
