"""Finds mixtures of atoms that explain the pixels of one channel, and their probabilities for several exposures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from manifold.core.records import Array, Indices, Mask
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.mixtures import LAMBERTIAN_SPREAD, Hypotheses, Mixtures, atom_pairs, products
from manifold.model.estimator import LEAST, Observation

GRID_STRIDE = 7
"""Stride over the directions of the encoding grid at which mixtures are compared."""

MODEL_ERROR = 0.05
"""Relative standard deviation of the pixels' cube roots about the best mixture."""

INDEPENDENT = 30.0
"""Effective number of independent errors among the pixels of a picture."""

_EXPONENT = 2.0  # power of the norm of mixtures by which their likelihood is divided
_COUNT = 200  # mixtures of which the mean is taken


@dataclass(frozen=True, eq=False)
class PixelPosterior:
    """Computes posterior probabilities of mixtures of two atoms, given one channel's pixels, for several exposures.

    It is the counterpart of `mixtures.posterior`, in values instead of cube roots. A clipped pixel is a lower bound
    and has no error if the mixture is brighter. The noise is proportional to the value for pixels brighter than
    `LEAST`, and constant below. The inner products of these bright and dark pixels are summed once and then scaled by
    the exposure.

    Attributes:
        exposures: divisors of the observed values, ascending, shape (E,).
        material_of: indices of the materials of the Q usable atoms, shape (Q,).
        n_library: number of measured materials.
        bright, dark: inner products of atoms over bright pixels, divided by the squared exposure, and over dark
            pixels, each (E, Q, Q).
        with_bright, with_dark: inner products of atoms and observations over bright pixels, divided by the exposure,
            and over dark pixels, multiplied by it, each (E, Q).
        square_bright, square_dark: squared norms of the observations over bright pixels, and over dark pixels,
            multiplied by the squared exposure, each (E,).
        bounds: atoms (Q, b), observed values (b,) and square roots of the weights (b,) of clipped pixels.
        of_grid: products of mixtures over all directions, see `mixtures.products`.
    """

    exposures: Array
    material_of: Indices
    n_library: int
    bright: Array
    dark: Array
    with_bright: Array
    with_dark: Array
    square_bright: Array
    square_dark: Array
    bounds: tuple[Array, Array, Array]
    of_grid: tuple[Array, Array, float]

    @classmethod
    def of(cls, atoms: LibraryAtoms, rows: Observation, usable: Mask, exposures: Array) -> PixelPosterior:
        """Sum the inner products over the pixels, for the usable atoms (n,)."""
        index = atoms.mixed[usable[atoms.mixed]]
        _, material_of = np.unique(atoms.material_of[index], return_inverse=True)
        A, is_seen = rows.atoms[index], ~rows.is_bound
        roots = np.sqrt(INDEPENDENT * rows.weights / rows.weights.sum()) / (3.0 * MODEL_ERROR)
        B, seen, b = A[:, is_seen], np.maximum(rows.seen[is_seen], 0.0), roots[is_seen]
        E, Q = len(exposures), len(index)
        inner, with_seen, square = np.zeros((2, E, Q, Q)), np.zeros((2, E, Q)), np.zeros((2, E))
        n_bright = np.searchsorted(LEAST * exposures, seen)  # exposures under which a pixel is brighter
        for count in np.unique(n_bright).tolist():
            own = n_bright == count
            some, s = B[:, own], seen[own]
            # Bright under exposures up to the last of these, and dark from the next on: sums over exposures follow.
            for k, (e, exists) in enumerate(((count - 1, count > 0), (count, count < E))):
                if exists:
                    noise = LEAST if k else s
                    X, y = some * (b[own] / noise), s * b[own] / noise
                    inner[k, e] = X @ X.T
                    with_seen[k, e] = X @ y
                    square[k, e] = y @ y
        for sums in (inner, with_seen, square):
            sums[0] = np.cumsum(sums[0, ::-1], axis=0)[::-1]
            np.cumsum(sums[1], axis=0, out=sums[1])
        n = int(material_of[-1])
        on_grid = atoms.grid_products(GRID_STRIDE)[np.ix_(index, index)]
        bounds = A[:, rows.is_bound], rows.seen[rows.is_bound], roots[rows.is_bound]
        return cls(
            exposures, material_of, n - len(atoms.coats), inner[0], inner[1], with_seen[0], with_seen[1], square[0],
            square[1], bounds, products(on_grid, *atom_pairs(n, (Q - 1) // n)),
        )  # fmt: skip

    def at(self, e: int) -> Mixtures:
        """Return the mixtures for one of the exposures, given its index."""
        t = float(self.exposures[e])
        inner = t * t * self.bright[e] + self.dark[e]
        with_seen = t * self.with_bright[e] + self.with_dark[e] / t
        square = float(self.square_bright[e] + self.square_dark[e] / t**2)
        mixtures = Mixtures.of_products(inner, with_seen, square, self.material_of, self.n_library)
        misfit, (A, seen, roots) = mixtures.misfit, self.bounds
        scale = roots / np.maximum(seen / t, LEAST)
        for row, bound in zip((A * scale).T, seen / t * scale, strict=True):
            misfit = misfit + np.maximum(bound - mixtures.of(row), 0.0) ** 2
        # A Lambertian as bright as what was seen, or black to the eye.
        albedo = max(float(with_seen[-1]) / (float(inner[-1, -1]) + LAMBERTIAN_SPREAD**-2), LEAST)
        relative = np.maximum(mixtures.norm_of(self.of_grid) / (albedo**2 * self.of_grid[2]), 1.0)
        return replace(mixtures, misfit=misfit).weighed(INDEPENDENT, relative, _EXPONENT)


def pixel_mixtures(atoms: LibraryAtoms, rows: Observation, usable: Mask) -> Hypotheses:
    """Return the most probable mixtures for the pixels of one channel, for an exposure of 1."""
    pixels = PixelPosterior.of(atoms, rows, usable, np.ones(1))
    mixtures = pixels.at(0)
    best = mixtures.most_probable(_COUNT)
    probability = mixtures.probability[best] / mixtures.probability[best].sum()
    weights = mixtures.weights(best)
    alike = mixtures.alike(pixels.material_of, pixels.n_library)
    found = Hypotheses(probability, weights, (probability @ weights)[None], alike)
    return found.among(atoms.mixed[usable[atoms.mixed]], len(atoms))
