"""Posterior over mixtures of two materials, given a few readings of a material and its gloss.

Mixtures of single bands are fitted to the mean over bands; those that are probable are then updated band by band. The
highlight of a coat is white and that of a metal coloured: single bands say more than their mean about which materials
the readings resemble.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from manifold.colour.conversion import luminance
from manifold.directions import from_spherical
from manifold.estimate.gloss import gloss_differences, value_of_unit
from manifold.estimate.mixtures import SCALE_SPREAD, Hypotheses, Mixtures, log_prior_of, material_prior
from manifold.estimate.residual import cells, coordinates, covariance
from manifold.formats.readings import Readings
from manifold.nonnegative import nonnegative_weights
from manifold.records import Array, Indices, Mask

NOISE = 0.02
"""Standard deviation of the noise of cube roots, relative to them and their root mean square."""

MODEL_ERROR = 0.04
"""Standard deviation of the residual of the best mixture, relative to the same."""

_REACH = 2.0  # correlation length of the residual of mixtures, in lengths of `residual`
_EXPONENT = 5.0  # of the norm of mixtures
_COUNT = 100  # of hypotheses
_CONSIDERED = 4000  # most probable mixtures of atoms, of which many are of the same materials
_ALIKE = 0.07  # standard deviation between bands of the shares of materials
_COLOUR = 0.7  # weight of the differences between bands against their mean


@dataclass(frozen=True, eq=False)
class ReadingRoots:
    """Cube roots of a material and of atoms at P readings.

    Errors of an `Observation` are independent; these are alike at nearby directions, by what all bands were read at.

    Attributes:
        atoms: of n atoms and, last, of the Lambertian, shape (n + 1, P).
        material: in B bands, NaN where not measured, shape (B, P).
        weights: of the readings, shape (P,).
        where: coordinates of their directions, see `residual.coordinates`, shape (P, 3).
    """

    atoms: Array
    material: Array
    weights: Array
    where: Array

    def part(self, bands: Indices, readings: Mask) -> ReadingRoots:
        """Some bands, by index, at some readings, by mask."""
        material = self.material[bands][:, readings]
        return ReadingRoots(self.atoms[:, readings], material, self.weights[readings], self.where[readings])

    def whitened(self) -> tuple[Array, Array]:
        """Atoms (n + 1, C) and material (B, C): their differences are independent and of variance 1.

        C is the number of readings, or of averages of those that share a cell.
        """
        cell = cells(self.where)
        total = np.bincount(cell, self.weights)

        def averaged(rows: Array) -> Array:
            return np.array([np.bincount(cell, row * self.weights) for row in rows]) / total

        atoms, material, where = averaged(self.atoms), averaged(self.material), averaged(self.where.T).T
        square = np.mean(material**2, axis=0)
        level = np.sqrt(square + np.average(square, weights=total) + 1e-12)
        noise = np.diag(NOISE**2 / total) + MODEL_ERROR**2 * covariance(where / _REACH, where / _REACH)
        L = np.linalg.cholesky(noise)
        white = [solve_triangular(L, (rows / level).T, lower=True).T for rows in (atoms, material)]
        return white[0], white[1]


@dataclass(frozen=True, eq=False)
class GlossReadings:
    """G readings of gloss beside those of a material: means over apertures around mirror directions.

    They are of its luminance, which no band has alone: in cube roots no `Observation` of one band.

    Attributes:
        atoms: cube roots of these means of n atoms and, last, of the Lambertian, shape (n + 1, G).
        roots: cube roots of the material's luminance there, shape (G,).
        luminance: what the bands of the readings contribute to it, shape (B,).
        where: coordinates of the mirror directions, see `residual.coordinates`, shape (G, 3).
        unit: mean of f over the apertures that makes one gloss unit, in 1/sr, shape (G,).
    """

    atoms: Array
    roots: Array
    luminance: Array
    where: Array
    unit: Array

    @classmethod
    def of(cls, readings: Readings, atoms: Array) -> GlossReadings:
        """The gloss of a material, with that of atoms as cube roots (n + 1, G)."""
        unit = np.array([value_of_unit(angle) for angle in readings.gloss])
        mean = unit * list(readings.gloss.values())
        theta = np.deg2rad(list(readings.gloss), dtype=float)
        where = coordinates(from_spherical(theta, np.pi), from_spherical(theta, 0.0))
        return cls(atoms, np.cbrt(mean), luminance(np.eye(readings.bands.count), readings.bands), where, unit)

    def misfit(self, weights: Array, level: float) -> float:
        """Squared error of weights (B, n + 1) over its variance; `level`: root mean square of the other readings."""
        variance = (NOISE**2 + MODEL_ERROR**2) * (self.roots**2 + level**2)
        return float(np.sum((self._luminous(weights @ self.atoms) - self.roots) ** 2 / variance))

    def differences(self, roots: Array) -> Array:
        """Relative differences of cube roots in bands, shape (B, G), from what was read within a gloss unit: (G,)."""
        return gloss_differences(self._luminous(roots) ** 3 / self.unit, self.roots**3 / self.unit)

    def scaled(self, roots: Array) -> Array:
        """Cube roots in bands, shape (B, G), scaled to have the luminance that was read."""
        return np.asarray(roots * self.roots / np.maximum(self._luminous(roots), np.finfo(float).tiny))

    def _luminous(self, roots: Array) -> Array:
        return np.cbrt(np.maximum(self.luminance @ roots**3, 0.0))


def posterior(
    read: ReadingRoots, gram: Array, material_of: Indices, n_library: int | None = None
) -> Mixtures:
    """Posterior probabilities of mixtures of two atoms, given readings of a material in one band.

    The likelihood is Student's t in cube roots, with residuals that are correlated at nearby directions; its heavy
    tails keep several mixtures probable where none fits the readings. It is divided by the fifth power of the
    mixture's norm: a predicted highlight that does not exist costs more than one that is missing.

    Args:
        read: the readings, B = 1.
        gram: inner products of atoms over all directions, shape (n + 1, n + 1).
        material_of: which of N materials an atom is of, as many atoms of each; N for the Lambertian; shape (n + 1,).
        n_library: how many of the materials, the first ones, are measured; all by default. The others are coats.
    """
    X, (y,) = read.whitened()
    mixtures, n_readings = Mixtures.fitted(X, y, material_of, n_library), len(y)
    share = np.sqrt(read.weights / len(read.weights))
    X, y = read.atoms * share, read.material[0] * share
    unexplained = np.maximum(mixtures.norm(X @ X.T) - 2.0 * mixtures.of(X @ y) + y @ y, 0.0)
    return mixtures.weighed(n_readings, mixtures.norm(gram) + unexplained, _EXPONENT)


def band_mixtures(
    mixtures: Mixtures,
    read: ReadingRoots,
    gram: Array,
    material_of: Indices,
    gloss: GlossReadings | None = None,
    n_library: int | None = None,
) -> Hypotheses:
    """Posterior probabilities of mixtures of two materials, given readings in B bands.

    Weights >= 0 of the atoms of both materials and of the Lambertian are fitted to every band, with shares of materials
    near those in the mean of all bands. The likelihood is that of `mixtures.posterior`.

    Args:
        mixtures: of atoms, fitted to the mean over bands.
        read: the readings.
        gram, material_of, n_library: of the atoms, as in `mixtures.posterior`.
        gloss: readings of gloss, if there are any.
    """
    chosen = _of_different_materials(mixtures, material_of)
    structures = mixtures.weights(chosen)
    fitted = np.zeros((len(chosen), len(read.material), len(read.atoms)))
    misfit, count = ((mixtures.scale[chosen] - 1.0) / SCALE_SPREAD) ** 2, 0.0
    is_read = np.isfinite(read.material)
    any_read = is_read.any(axis=1)
    for mask in np.unique(is_read[any_read], axis=0):
        rows = np.flatnonzero((is_read == mask).all(axis=1))
        X, y = read.part(rows, mask).whitened()
        part = len(rows) / any_read.sum()
        count += part * (1.0 + _COLOUR) * y.shape[1]
        for h, structure in enumerate(structures):
            fitted[h, rows], of_bands = _fit_bands(X, y, structure, material_of)
            misfit[h] += part * of_bands
    of_mean = fitted[:, any_read].mean(axis=1)
    fitted[:, ~any_read] = of_mean[:, None]
    if gloss is not None:
        level = float(np.sqrt(np.mean(read.material[is_read] ** 2)))
        misfit += [gloss.misfit(weights, level) for weights in fitted]
        count += len(gloss.roots)
    residual = fitted @ read.atoms - np.where(is_read, read.material, 0.0)
    squares = np.sum(is_read * residual**2 * read.weights, axis=(1, 2)) / np.sum(is_read)
    norm = np.sum((of_mean @ gram) * of_mean, axis=1) + squares
    prior = material_prior(int(material_of[-1]), n_library)
    log_prior = log_prior_of(material_of[mixtures.first[chosen]], material_of[mixtures.second[chosen]], prior)
    probability = (
        replace(mixtures, log_prior=log_prior, misfit=misfit).weighed(count, norm, _EXPONENT).probability
    )
    order = np.argsort(-probability, kind="stable")
    return Hypotheses(probability[order], of_mean[order], np.tensordot(probability, fitted, 1))


def _of_different_materials(mixtures: Mixtures, material_of: Indices) -> Indices:
    """The most probable mixtures, one for every pair of materials and shares of them."""
    seen: dict[tuple[int, int, float], int] = {}
    for k in mixtures.most_probable(_CONSIDERED).tolist():
        i, j = int(material_of[mixtures.first[k]]), int(material_of[mixtures.second[k]])
        share = float(mixtures.share[k])
        if i > j:
            i, j, share = j, i, 1.0 - share
        seen.setdefault((i, j, 1.0 if i == j else round(share, 3)), k)
        if len(seen) == _COUNT:
            break
    return np.array(list(seen.values()))


def _fit_bands(X: Array, y: Array, structure: Array, material_of: Indices) -> tuple[Array, float]:
    """Weights (b, n + 1) in some bands of the atoms of a mixture's materials, and their misfit."""
    totals = np.bincount(material_of, structure)
    used = np.flatnonzero((totals[material_of] > 0.0) | (material_of == material_of[-1]))
    share = (material_of[used] == np.flatnonzero(totals[:-1] > 0.0)[:, None]) / _ALIKE
    towards = share @ structure[used]
    v = nonnegative_weights(X[used] @ X[used].T + share.T @ share, y @ X[used].T + towards @ share)
    residual = y - v @ X[used]
    mean = residual.mean(axis=0)
    apart = np.sum((v @ share.T - towards) ** 2) + _COLOUR * np.sum((residual - mean) ** 2)
    weights = np.zeros((len(y), len(material_of)))
    weights[:, used] = v
    return weights, float(mean @ mean + apart / len(y))
