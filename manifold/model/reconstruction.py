"""Describes a material as a non-negative combination of samples and analytic lobes; their number can be limited."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np

from manifold.analytic.free_lobes import Lobes
from manifold.brdf.interface import BRDF, all_isotropic, require_values
from manifold.brdf.measured import values_at
from manifold.colour import panel
from manifold.core.defaults import ROUNDING
from manifold.core.errors import UsageError
from manifold.core.mapping import Identity
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Indices, evenly_spaced
from manifold.core.threads import one_blas_thread
from manifold.gp.encoding import encoding_pairs
from manifold.gp.nonnegative import nonnegative_weights
from manifold.model.combination import Combination, Dictionary
from manifold.model.estimator import LEAST, Observation, explain
from manifold.model.materials import MaterialCache
from manifold.model.prediction import PredictedBRDF
from manifold.model.settings import LEARNT_BANDS

DICTIONARY = Dictionary((1.0, 2.0 / 3.0, 1.0 / 3.0), Lobes(soft_degree=4))
"""Atoms of reconstructions; powers of samples add broader lobes than the samples have."""

_SAMPLES_AT_ONCE = 300  # materials among which weights are found together
_OF_VALUES = 0.25  # how much the squared error of values counts beside that of pixels


class ComparedValues:
    """The values that a reconstruction compares: at direction pairs, then at K pixels of balls.

    `pixel_weights` (K,) give all lights the same total weight.
    """

    def __init__(self, pairs: Pairs) -> None:
        """Compare BRDFs at direction pairs (P, 3)."""
        self._lights = panel.fitted()
        self._pairs, self._cosines = pairs + self._lights, pairs.cosines
        self.pixel_weights = self._lights.pixel_weights
        self._lobes = self._of_values(DICTIONARY.lobes.values(self._pairs.wi, self._pairs.wo))

    @classmethod
    @cache
    def default(cls, is_isotropic: bool) -> ComparedValues:
        """Return the compared values at the direction pairs of the encoding grid."""
        return cls(encoding_pairs(is_isotropic))

    def weights(self, atoms: Array, brdf: BRDF, numbers: int | None = None) -> Array:
        """Return weights (B, n) of n atoms that describe a BRDF of B bands.

        `atoms` are the rows of `of_atoms`; the last ones are the lobes of `DICTIONARY`. If `numbers` is given, it
        limits the number of parameters (see `few_atoms`); weights are then found in at most `LEARNT_BANDS` bands and
        interpolated linearly.
        """
        material = self.of(brdf)
        if numbers is None:
            return explain(observations(atoms, material, self.pixel_weights))
        bands = evenly_spaced(len(material), LEARNT_BANDS)
        lambertian = len(atoms) - len(DICTIONARY.lobes)
        found = few_atoms(observations(atoms, material[bands], self.pixel_weights), numbers, lambertian)
        weights = np.zeros((len(material), len(atoms)))
        for k in np.flatnonzero(found.any(axis=0)):
            weights[:, k] = np.interp(np.arange(len(material)), bands, found[:, k])
        return weights

    def of(self, brdf: BRDF) -> Array:
        """Return the compared values of a BRDF of B bands, shape (B, R)."""
        f = values_at(brdf, self._pairs)
        return self._of_values(
            require_values(f, len(self._pairs), brdf.bands, "the material to reconstruct").T
        )

    def of_atoms(self, materials: Sequence[BRDF]) -> Array:
        """Return the compared values of the atoms that `DICTIONARY` makes of materials, shape (n', R)."""
        samples = [np.maximum(values_at(brdf, self._pairs).T, 0.0) for brdf in materials]
        powers = [self._of_values(f**exponent) for exponent in DICTIONARY.exponents for f in samples]
        return np.vstack([*powers, self._lobes])

    def _of_values(self, f: Array) -> Array:
        """Return the compared values of f in 1/sr, shape (n, P + P_ball)."""
        P = len(self._cosines)
        return np.hstack([f[:, :P] * self._cosines, self._lights.of(f[:, P:].T).T])


def observations(atoms: Array, material: Array, pixel_weights: Array) -> list[Observation]:
    """Return the observations of a material (B, R) in every band, for atoms (n, R).

    The last of the R values are pixels. Cube-root errors are relative to the norm over all bands, separately for the
    values and for the pixels with weights (K,). Pixels brighter than display white are ignored.
    """
    material = np.maximum(material, 0.0)
    n_values = material.shape[1] - len(pixel_weights)
    is_pixel = np.arange(material.shape[1]) >= n_values
    each = np.concatenate([np.ones(n_values), pixel_weights])
    counts = np.where(is_pixel & (material >= 1.0), 0.0, each * np.where(is_pixel, 1.0, _OF_VALUES))
    squares = np.sum((counts > 0.0) * each * material ** (2.0 / 3.0), axis=0)
    for rows in (is_pixel, ~is_pixel):
        counts[:, rows] /= max(float(squares[rows].sum()), LEAST)
    no_bound = np.zeros(material.shape[1], bool)
    return [Observation(atoms, *each, no_bound) for each in zip(material, counts, strict=True)]


def reconstruct(
    materials: MaterialCache,
    sample_bands: Indices,
    brdf: BRDF,
    numbers: int | None = None,
) -> PredictedBRDF:
    """Describe a material as a non-negative combination of bands of materials and analytic lobes.

    See `estimator.explain`. More than 300 materials are searched in groups of 300, together with the materials that
    had weights in earlier groups.

    Args:
        materials: the materials of the library.
        sample_bands: increasing indices of the bands that serve as basis functions, shape (B_s,).
        brdf: the material to describe, in the bands of the library.
        numbers: largest number of parameters, see `ComparedValues.weights`; None sets no limit.
    """
    if numbers is not None and numbers < 1:
        raise UsageError(f"found a limit of {numbers} parameters, expected at least 1")
    sampled, N = list[BRDF](), len(materials.names)
    for first in range(0, N, _SAMPLES_AT_ONCE):
        new = materials.names[first : first + _SAMPLES_AT_ONCE]
        sampled += materials.in_bands(sample_bands.tolist(), new)
        compared, is_last = (
            ComparedValues.default(all_isotropic([brdf, *sampled])),
            first + _SAMPLES_AT_ONCE >= N,
        )
        weights = compared.weights(compared.of_atoms(sampled), brdf, numbers if is_last else None)
        if not is_last:
            of_samples = weights[:, : -len(DICTIONARY.lobes)].any(axis=0)
            has_any = of_samples.reshape(-1, len(sampled), len(sample_bands)).any(axis=(0, 2))
            sampled = [sampled[k] for k in np.flatnonzero(has_any)]
    if not np.any(weights):
        raise UsageError(
            "the material to reconstruct is black: expected a value above 0 at some direction pair"
        )
    combination = Combination(Identity(), weights, sample_bands, dictionary=DICTIONARY)
    return PredictedBRDF(sampled, combination, brdf.bands)


_CANDIDATES = 40  # atoms of either sort, those of largest slope, that are tried each time
_SWEEPS = 4
_FEW = 6  # terms, of which pairs are exchanged, too


def few_atoms(bands: Sequence[Observation], numbers: int, lambertian: int) -> Array:
    """Return weights v >= 0 of a few of n atoms that explain the observations in every band, shape (B, n).

    It minimises the objective of `estimator.explain` without a prior, with at most `numbers` parameters. An atom
    costs one parameter for its index, and one weight per band or one weight for all bands; the Lambertian needs no
    index. Atoms are added greedily in two ways, by the error that they save and by the error that they save per
    parameter, and the result with the lower error is kept. Then single atoms and pairs are exchanged if that improves
    the fit.
    """
    atoms, seen = bands[0].atoms, np.array([band.seen for band in bands])

    def search_near(fitted: Array) -> _NumberSearch:
        slopes = np.array([band.slopes(row) for band, row in zip(bands, fitted, strict=True)])
        return _NumberSearch(atoms, seen, slopes, lambertian)

    with one_blas_thread:
        search = search_near(seen)
        terms, error = search.extended([], numbers)
        for _ in range(_SWEEPS):
            before = error
            # Each term is taken out in turn, and of few terms each pair.
            pairs = combinations(terms, 2) if len(terms) <= _FEW else ()
            for out in [*((term,) for term in terms), *pairs]:
                found, lower = search.extended([term for term in terms if term not in out], numbers)
                if lower < error:
                    terms, error = found, lower
            if error > (1.0 - 1e-3) * before:
                break
        return search_near(search.weights(terms) @ atoms).weights(terms)


class _Term(NamedTuple):
    atom: int
    is_shared: bool  # whether all bands share one weight


class _NumberSearch:
    """Least squares of a material (B, R) by few of n atoms (n, R), errors multiplied by slopes (B, R)."""

    def __init__(self, atoms: Array, material: Array, slopes: Array, lambertian: int) -> None:
        self._atoms, self._slopes, self._lambertian = atoms, slopes, lambertian
        self._target = material * slopes
        self._norms = np.maximum((slopes**2) @ (atoms**2).T, np.finfo(float).tiny)  # [B, n]

    def extended(self, terms: list[_Term], numbers: int) -> tuple[list[_Term], float]:
        """Add terms greedily within the numbers left, by the error saved and by the error saved per number.

        Return the terms of the better result, and the squared error.
        """
        return min((self._extended(terms, numbers, power) for power in (0, 1)), key=lambda found: found[1])

    def _extended(self, terms: list[_Term], numbers: int, power: int) -> tuple[list[_Term], float]:
        weights, error = self._solve(terms, [terms])[0]
        while True:
            left = numbers - sum(map(self._cost, terms))
            tried = [[*terms, term] for term in self._candidates(terms, weights, left)]
            solved = self._solve([each[-1] for each in tried] + terms, tried)
            gains = [
                (error - e) / self._cost(each[-1]) ** power
                for each, (_, e) in zip(tried, solved, strict=True)
            ]
            if not gains or max(gains) < ROUNDING:
                return terms, error
            best = int(np.argmax(gains))
            terms, (weights, error) = tried[best], solved[best]

    def weights(self, terms: list[_Term]) -> Array:
        """Return the best weights of terms, shape (B, n)."""
        every = np.zeros((len(self._target), len(self._atoms)))
        for term, column in zip(terms, self._solve(terms, [terms])[0][0].T, strict=True):
            every[:, term.atom] += column
        return every

    def _cost(self, term: _Term) -> int:
        return (1 if term.is_shared else len(self._target)) + (term.atom != self._lambertian)

    def _candidates(self, terms: Sequence[_Term], weights: Array, left: int) -> list[_Term]:
        """Return the best term of each kind that costs at most `left` numbers."""
        fitted = weights @ self._atoms[[term.atom for term in terms]]
        slopes = ((self._target - fitted * self._slopes) * self._slopes) @ self._atoms.T  # [B, n]
        gains = (
            np.sum(np.maximum(slopes, 0.0) ** 2 / self._norms, axis=0),
            np.maximum(slopes.sum(axis=0), 0.0) ** 2 / self._norms.sum(axis=0),
        )
        best = [
            _Term(int(atom), bool(is_shared))
            for is_shared, gain in enumerate(gains)
            for atom in np.argsort(-gain)[:_CANDIDATES]
            if gain[atom] > 0.0
        ]
        return [term for term in best if self._cost(term) <= left and term not in terms]

    def _solve(self, pool: list[_Term], choices: list[list[_Term]]) -> list[tuple[Array, float]]:
        """Return the best weights (B, terms) of each choice from a pool of terms, and the squared error.

        Choices differ in one atom at most.
        """
        found: list[tuple[Array, float]] = []
        if not choices:
            return found
        atoms = sorted({term.atom for term in pool})
        position = {atom: k for k, atom in enumerate(atoms)}
        rows = self._atoms[atoms] * self._slopes[:, None]  # [B, m, R]
        cross = rows @ self._target[..., None]
        B, norm = len(rows), float(np.sum(self._target**2))
        common = sorted(set.intersection(*({position[term.atom] for term in terms} for terms in choices)))
        # No choice needs the products of two atoms in which choices differ.
        gram = np.zeros((B, len(atoms), len(atoms)))
        gram[:, range(len(atoms)), range(len(atoms))] = np.sum(rows**2, axis=2)
        gram[:, :, common] = rows @ rows[:, common].transpose(0, 2, 1)
        gram[:, common] = gram[:, :, common].transpose(0, 2, 1)
        for terms in choices:
            # One unknown per term and band, then those that bands share are added up.
            at = [position[term.atom] for term in terms]
            shares = [np.ones((B, 1)) if term.is_shared else np.eye(B) for term in terms]
            spread = np.zeros((B, len(terms), sum(share.shape[1] for share in shares)))
            first = 0
            for k, share in enumerate(shares):
                spread[:, k, first : first + share.shape[1]] = share
                first += share.shape[1]
            H = np.sum(spread.transpose(0, 2, 1) @ gram[:, at][:, :, at] @ spread, axis=0)
            c = np.sum(spread.transpose(0, 2, 1) @ cross[:, at], axis=0)[:, 0]
            v = nonnegative_weights(H, c[None])[0] if terms else c
            found.append((spread @ v, norm - 2.0 * float(v @ c) + float(v @ H @ v)))
        return found
