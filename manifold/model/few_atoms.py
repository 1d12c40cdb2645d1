"""A material in few numbers: a combination of few atoms."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from manifold.model.observation import Observation
from manifold.nonnegative import nonnegative_weights
from manifold.records import Array
from manifold.threads import one_blas_thread

_CANDIDATES = 40  # of either sort, those of largest slope, are tried each time
_SWEEPS = 4
_FEW = 6  # terms, of which pairs are exchanged, too
_LEAST_GAIN = 1e-9  # of the relative squared error


def few_atoms(bands: Sequence[Observation], numbers: int, lambertian: int) -> Array:
    """Weights v >= 0 of few of n atoms that explain what was seen in every band.

    Minimises what `estimator.explain` minimises without a prior. An atom takes a number that says which it is, and a
    weight per band, or one weight that all bands share; a Lambertian is always meant, and takes its weights alone.
    Atoms enter by the error that they save per number; then each is taken out in turn, and others take its place where
    that is better.

    Args:
        bands: what was seen in each, by the same functionals.
        numbers: at most so many, at least 1.
        lambertian: the index of that atom.
    Returns:
        Shape (B, n), mostly zeros.
    """
    atoms, seen = bands[0].atoms, np.array([band.seen for band in bands])

    def search_near(fitted: Array) -> _Search:
        slopes = np.array([band.slopes(row) for band, row in zip(bands, fitted, strict=True)])
        return _Search(atoms, seen, slopes, lambertian)

    with one_blas_thread:
        search = search_near(seen)
        terms, error = search.extended([], numbers)
        for _ in range(_SWEEPS):
            before = error
            for out in _taken_out(terms):
                found, lower = search.extended([term for term in terms if term not in out], numbers)
                if lower < error:
                    terms, error = found, lower
            if error > (1.0 - 1e-3) * before:
                break
        return search_near(search.weights(terms) @ atoms).weights(terms)


def _taken_out(terms: list[_Term]) -> list[tuple[_Term, ...]]:
    """What is taken out in turn: each term, and of few terms each pair."""
    pairs = combinations(terms, 2) if len(terms) <= _FEW else ()
    return [*((term,) for term in terms), *pairs]


class _Term(NamedTuple):
    atom: int
    is_shared: bool  # by all bands: one weight


class _Search:
    """Least squares of a material (B, R) by few of n atoms (n, R), errors multiplied by slopes (B, R)."""

    def __init__(self, atoms: Array, material: Array, slopes: Array, lambertian: int) -> None:
        self._atoms, self._slopes, self._lambertian = atoms, slopes, lambertian
        self._target = material * slopes
        self._norms = np.maximum((slopes**2) @ (atoms**2).T, np.finfo(float).tiny)  # [B, n]

    def extended(self, terms: list[_Term], numbers: int) -> tuple[list[_Term], float]:
        """Terms, and those that save most, or most per number, as numbers are left; and the squared error."""
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
            if not gains or max(gains) < _LEAST_GAIN:
                return terms, error
            best = int(np.argmax(gains))
            terms, (weights, error) = tried[best], solved[best]

    def weights(self, terms: list[_Term]) -> Array:
        """The best weights of terms, shape (B, n)."""
        every = np.zeros((len(self._target), len(self._atoms)))
        for term, column in zip(terms, self._solve(terms, [terms])[0][0].T, strict=True):
            every[:, term.atom] += column
        return every

    def _cost(self, term: _Term) -> int:
        return (1 if term.is_shared else len(self._target)) + (term.atom != self._lambertian)

    def _candidates(self, terms: Sequence[_Term], weights: Array, left: int) -> list[_Term]:
        """Terms of at most so many numbers that save most by themselves."""
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
        """The best weights (B, terms) of each choice from a pool of terms, and the squared error."""
        atoms = sorted({term.atom for term in pool})
        position = {atom: k for k, atom in enumerate(atoms)}
        rows = self._atoms[atoms] * self._slopes[:, None]  # [B, m, R]
        gram, cross = rows @ rows.transpose(0, 2, 1), rows @ self._target[..., None]
        B, norm = len(rows), float(np.sum(self._target**2))
        found = []
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
