"""The atoms (basis functions) of an estimate: single bands of a library's materials, dielectric coats, and lobes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from manifold.analytic.free_lobes import Lobes
from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf.interface import BRDF, all_isotropic
from manifold.colour import ball_colours, panel
from manifold.core.errors import UnknownNameError, UsageError
from manifold.core.mapping import CubeRoot, Identity
from manifold.core.names import counted, names_like
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands, Indices, Mask, evenly_spaced
from manifold.estimate.gloss import gloss_meter
from manifold.estimate.residual import coordinates
from manifold.gp.encoding import encoding_pairs
from manifold.library.store import Library
from manifold.model.combination import Combination, Dictionary
from manifold.model.decoding import OF_BALL, roots_at
from manifold.model.diagnostics import SHOWN_WEIGHT
from manifold.model.materials import MaterialCache
from manifold.model.prediction import PredictedBRDF
from manifold.model.reconstruction import DICTIONARY
from manifold.model.settings import SAMPLE_BANDS

MOST_MATERIALS = 1000
"""Largest number of materials of a library that estimates accept."""

COAT_ALPHAS = tuple(np.geomspace(0.015, 0.26, 10).tolist())  # duller ones replace measured matt materials
COAT_INDICES = (1.42, 1.58)
_COAT_BASE = 0.9  # largest reflectance of what is below a coat
_LEAST_COAT = 0.05  # mean prior weight from which a coat is fitted to the readings
LAMBERTIAN = Dictionary(lobes=Lobes((), ()))
"""Dictionary with the Lambertian, the only analytic lobe among atoms of cube roots."""
_MOST_SHOWN = 6  # materials of a mixture


@cache
def ball_coordinates() -> Array:
    """Return coordinates of the direction pairs of a ball in the five test lights, see `residual.coordinates`."""
    lights = panel.judged()
    return coordinates(lights.wi, lights.wo)


@cache
def grid_coordinates() -> Array:
    """Return the coordinates of the encoding grid's direction pairs, see `residual.coordinates`."""
    grid = encoding_pairs()
    return coordinates(grid.wi, grid.wo)


def shown_shares(names: Sequence[str], weights: Array) -> tuple[tuple[str, float], ...]:
    """Return the names and weights of a mixture's materials to show, largest first; the result is empty for black."""
    order = np.argsort(-weights, kind="stable")[:_MOST_SHOWN]
    shown = tuple((names[m], float(weights[m])) for m in order if weights[m] > SHOWN_WEIGHT * weights.sum())
    return shown or (("black", 1.0),)


@dataclass(frozen=True, eq=False)
class LibraryAtoms:
    """n atoms whose non-negative combinations explain observations, all in one band.

    By default their cube roots are combined; the atoms are then single bands of m materials, and a Lambertian. After
    `in_values`, the values f are combined, because pixels measure sums of light; the atoms then also include powers
    of the library's bands (broader lobes) and lobes with free Fresnel terms (colours that change with incidence).

    Attributes:
        names: names of the materials of the library.
        coats: names of the other materials, the dielectric coats, see `dielectric_coats`.
        bands: bands of the library.
        atom_bands: indices of the bands that are atoms, shape (B_s,); atom k * B_s + s is band s of material k.
        materials: the m materials, in these bands only.
        directions: cube roots of the bands and the Lambertian at the encoding grid, then at some direction pairs of a
            ball, shape (m B_s + 1, P).
        weights: weights of these direction pairs, which give grid and ball the same energy, shape (P,).
        grid: the encoding grid.
        ball: cube roots at all direction pairs of a ball in the five test lights, shape (m B_s + 1, P_b).
        is_linear: whether values are combined instead of cube roots.
    """

    names: tuple[str, ...]
    coats: tuple[str, ...]
    bands: Bands
    atom_bands: Indices
    materials: Sequence[BRDF]
    directions: Array
    weights: Array
    grid: Pairs
    ball: Array
    is_linear: bool = False

    def __len__(self) -> int:
        return len(self.material_of)

    @classmethod
    def of_library(cls, library: Library | Path | str) -> LibraryAtoms:
        """Evaluate all materials of a library, given itself or by its path; negative values are treated as 0.

        Raises:
            UsageError: the library has fewer than three, or more than `MOST_MATERIALS` materials.
            LibraryError: a material cannot be read.
        """
        if not isinstance(library, Library):
            library = Library.open(library)
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
        chosen = evenly_spaced(bands.count, SAMPLE_BANDS)
        cache = MaterialCache(library, names, is_nonnegative=True)
        coats = dielectric_coats(bands.select(chosen))
        materials: list[BRDF] = [*cache.in_bands(chosen.tolist()), *coats.values()]
        grid, lights = encoding_pairs(all_isotropic(materials)), panel.judged()
        on_grid, on_ball = (_roots_at(materials, pairs) for pairs in (grid, lights))
        ball = ball_colours.ball()  # in the studio, whose pairs are the first
        some = on_ball[:, : len(ball)][:, OF_BALL]
        of_grid, of_ball = grid.cosines ** (2.0 / 3.0), ball.light[OF_BALL] ** (2.0 / 3.0)
        energy = [
            float(np.sum(roots**2 @ weights)) for roots, weights in ((on_grid, of_grid), (some, of_ball))
        ]
        of_ball = of_ball * energy[0] / max(energy[1], np.finfo(float).tiny)
        return cls(
            names, tuple(coats), bands, chosen, materials, np.hstack([on_grid, some]),
            np.concatenate([of_grid, of_ball]), grid, on_ball,
        )  # fmt: skip

    @property
    def n_grid(self) -> int:
        """Return the number of direction pairs of the grid."""
        return len(self.grid.wi)

    @property
    def band_axis(self) -> Bands:
        """The bands of the atoms of one material."""
        return self.bands.select(self.atom_bands)

    @property
    def in_values(self) -> LibraryAtoms:
        """Return the atoms of the same materials that combine values instead of cube roots."""
        return replace(self, is_linear=True)

    @property
    def dictionary(self) -> Dictionary:
        """The dictionary that makes the atoms: powers of the library's bands, and lobes."""
        return DICTIONARY if self.is_linear else LAMBERTIAN

    @cached_property
    def material_of(self) -> Indices:
        """Index of each atom's material, shape (n,); lobes have the index m."""
        own = np.repeat(np.arange(len(self.materials)), len(self.atom_bands))
        powers = np.tile(own[: self.n_measured], len(self.dictionary.exponents) - 1)
        return np.concatenate([own, powers, np.full(len(self.dictionary.lobes), len(self.materials))])

    @property
    def mixed(self) -> Indices:
        """Indices of the atoms that mixtures combine: bands of materials, then the Lambertian, shape (m B_s + 1,)."""
        lambertian = len(self) - len(self.dictionary.lobes)
        return np.append(np.arange(len(self.directions) - 1), lambertian)

    @cached_property
    def gram(self) -> Array:
        """Inner products of the atoms, averaged over the grid, shape (n, n)."""
        roots, weights = self.directions[:, : self.n_grid], self.weights[: self.n_grid]
        return (roots * weights) @ roots.T / self.n_grid

    @property
    def n_measured(self) -> int:
        """Return the number of atoms of the library's materials, which come first."""
        return len(self.names) * len(self.atom_bands)

    def usable(self, prior: Array) -> Mask:
        """Return a mask (n,) of usable atoms: the library's, the Lambertian, and coats with enough `prior` (B, n)."""
        totals = np.bincount(self.material_of, prior.mean(axis=0))
        totals[: len(self.names)] = totals[-1] = np.inf
        return np.asarray(totals[self.material_of] > _LEAST_COAT)

    def index(self, material: int | str) -> int:
        """Return the index of a material of the library, given its name or index.

        Raises:
            UnknownNameError: there is no such material.
        """
        if material in self.names:
            return self.names.index(str(material))
        if isinstance(material, str):
            raise UnknownNameError(
                f"no material '{material}' in the library; {names_like(self.names, material)}"
            )
        if not 0 <= material < len(self.names):
            raise UnknownNameError(f"no material {material}, expected 0 to {len(self.names) - 1}, or a name")
        return int(material)

    def without(self, material: int | str) -> LibraryAtoms:
        """Return the atoms of all materials of the library except one, given by its name or index.

        Raises:
            UnknownNameError: there is no such material.
        """
        left_out = self.index(material)
        rows = np.flatnonzero(self.material_of[self.mixed] != left_out)
        left = replace(
            self,
            names=tuple(name for m, name in enumerate(self.names) if m != left_out),
            materials=[brdf for m, brdf in enumerate(self.materials) if m != left_out],
            directions=self.directions[rows],
            ball=self.ball[rows],
        )
        left.__dict__["gram"] = self.gram[np.ix_(rows, rows)]
        return left

    def in_atom_bands(self) -> LibraryAtoms:
        """Return the atoms as those of a library that has only the bands `atom_bands`."""
        same = replace(self, bands=self.band_axis, atom_bands=np.arange(len(self.atom_bands)))
        same.__dict__["gram"] = self.gram
        return same

    def at(self, wi: Array, wo: Array) -> Array:
        """Return the atoms at direction pairs (P, 3), as cube roots or as f in 1/sr, shape (n, P)."""
        return self._at(Pairs(wi, wo))

    def _at(self, pairs: Pairs) -> Array:
        return self._from_roots(_roots_at(self.materials, pairs), pairs)

    def _from_roots(self, roots: Array, pairs: Pairs) -> Array:
        """Return atoms from cube roots of bands and Lambertian at P pairs, shape (n, P)."""
        if not self.is_linear:
            return roots
        measured = roots[: self.n_measured]
        powers = [measured ** (3.0 * exponent) for exponent in self.dictionary.exponents[1:]]
        return np.vstack([roots[:-1] ** 3, *powers, self.dictionary.lobes.values(pairs.wi, pairs.wo)])

    @cached_property
    def on_grid(self) -> Array:
        """Atoms that hold values, times both cosines, at the encoding grid, shape (n, P_g)."""
        return self._from_roots(self.directions[:, : self.n_grid], self.grid) * self.grid.cosines

    def grid_values(self, weights: Array) -> Array:
        """Return the f that weights (B, n) of atoms that hold values give at the encoding grid, shape (P_g, B)."""
        return np.asarray((weights @ self.on_grid / self.grid.cosines).T)

    def grid_products(self, stride: int) -> Array:
        """Return the inner products of atoms that hold values over every `stride`-th pair of the grid, shape (n, n)."""
        kept: dict[int, Array] = self.__dict__.setdefault("_grid_products", {})
        if stride not in kept:
            some = self.on_grid[:, ::stride]
            kept[stride] = some @ some.T
        return kept[stride]

    @cached_property
    def on_ball(self) -> Array:
        """Pixels of the balls of atoms that hold values, in the five test lights, shape (n, K)."""
        lights = panel.judged()
        return lights.of(self._from_roots(self.ball, lights).T).T

    def at_gloss_meters(self, angles_deg: Sequence[float]) -> Array:
        """Return means of atoms over the apertures of gloss meters at G angles, shape (n, G).

        The means are of f in 1/sr, or are given as their cube roots if cube roots are combined.
        """
        means = np.empty((len(self), len(angles_deg)))
        for k, meter in enumerate(map(gloss_meter, angles_deg)):
            atoms = self._at(meter).T
            means[:, k] = meter.mean(atoms)[0] if self.is_linear else np.cbrt(meter.mean(atoms**3)[0])
        return means

    def predicted(self, weights: Array, bands: Bands | None = None) -> PredictedBRDF:
        """Return the mixture of the atoms with weights (B, n); its bands are by default those of the library."""
        m, measured = len(self.mixed) - 1, self.n_measured
        powers = range(m, m + (len(self.dictionary.exponents) - 1) * measured, measured)
        no_coats = np.zeros((len(weights), m - measured))
        blocks = [part for k in powers for part in (weights[:, k : k + measured], no_coats)]
        columns = [weights[:, :m], *blocks, weights[:, m + len(powers) * measured :]]
        mapping = Identity() if self.is_linear else CubeRoot()
        combination = Combination(mapping, np.hstack(columns), self.atom_bands, dictionary=self.dictionary)
        return PredictedBRDF(self.materials, combination, bands or self.bands)


def dielectric_coats(bands: Bands) -> dict[str, Plastic]:
    """Return rough dielectrics over a diffuse base, by name, from sharp to dull; only the base varies with the band.

    A mixture of the bands of one coat can have a base of any colour under the same Fresnel highlight.
    """
    bases = np.linspace(0.0, np.cbrt(_COAT_BASE), bands.count) ** 3
    return {
        f"dielectric coat (alpha {alpha:.2g}, index {eta:g})": Plastic(
            GGX.isotropic(alpha), np.array(eta), bases, bands
        )
        for alpha in COAT_ALPHAS
        for eta in COAT_INDICES
    }


def _roots_at(materials: Sequence[BRDF], pairs: Pairs) -> Array:
    """Return cube roots of atoms and, last, of the Lambertian of albedo 1 at direction pairs, shape (n + 1, P)."""
    roots = np.ascontiguousarray(roots_at(materials, pairs))
    return np.vstack([roots, LAMBERTIAN.lobes.cube_roots(pairs.wi, pairs.wo)])
