"""Finds non-negative weights of atoms (basis functions) that explain observations, linear functionals of a BRDF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from manifold.core.defaults import ROUNDING
from manifold.core.records import Array, Mask
from manifold.core.threads import one_blas_thread
from manifold.gp.nonnegative import nonnegative_weights

LEAST = 216.0 / 24389.0
"""Share of display white below which CIELAB lightness is linear."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Observed values (rows) of R linear functionals of a material in one band.

    A row may be a value at a direction pair, a pixel of a ball or of a photograph, or a mean over the
    aperture of a gloss meter; rows of several kinds may be combined.

    Attributes:
        atoms: the functionals of n atoms, shape (n, R).
        seen: the observed values, shape (R,).
        weights: weight of the squared error of each row, shape (R,).
        is_bound: whether the material is at least as bright as observed, because the camera clipped it, shape (R,).
        is_root: whether the rows are functionals of cube roots of the BRDF.
        n_beside: number of rows, the last ones, that were added to a camera's pixels by `beside`.
    """

    atoms: Array
    seen: Array
    weights: Array
    is_bound: Mask
    is_root: bool = False
    n_beside: int = 0

    @classmethod
    def joined(cls, parts: Sequence[Observation]) -> Observation:
        """Join the rows of several observations."""
        seen, weights, bounds = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("seen", "weights", "is_bound")
        )
        return cls(np.concatenate([part.atoms for part in parts], axis=1), seen, weights, bounds)

    def beside(self, other: Observation) -> Observation:
        """Return these pixels with rows of another source added.

        The added rows are never clipped and do not affect the prior.
        """
        n_beside = self.n_beside + len(other.seen)
        return replace(Observation.joined([self, other]), n_beside=n_beside)

    @property
    def pixels(self) -> Observation:
        """Return the rows without those that `beside` added."""
        n = len(self.seen) - self.n_beside
        return Observation(self.atoms[:, :n], self.seen[:n], self.weights[:n], self.is_bound[:n])

    def scaled(self, exposure: float) -> Observation:
        """Return the observation with its values divided by an exposure."""
        return replace(self, seen=self.seen / exposure)

    @property
    def relative(self) -> Observation:
        """Return the observation with weights that make squared cube-root errors relative to the observed values."""
        norm = float(self.weights @ np.maximum(self.seen, 0.0) ** (2.0 / 3.0))
        return replace(self, weights=self.weights / max(norm, LEAST * float(self.weights.sum())))

    def slopes(self, fitted: Array) -> Array:
        """Return the factors (R,) that convert errors of fitted rows (R,) to errors of cube roots.

        Below 0.9 % of display white, cube roots are replaced by a line, as in CIELAB. Satisfied bounds have the
        factor 0.
        """
        counts = np.sqrt(np.where(self.is_bound & (fitted >= self.seen), 0.0, self.weights))
        if self.is_root:
            return counts
        a, b = np.cbrt(np.maximum(self.seen, 0.0)), np.cbrt(np.maximum(fitted, 0.0))
        return np.asarray(counts / np.maximum(a * a + a * b + b * b, 3.0 * LEAST ** (2.0 / 3.0)))

    def error(self, weights: Array) -> float:
        """Return the root of the weighted squared error of cube roots for weights (n,) of atoms."""
        fitted = weights @ self.atoms
        return float(np.linalg.norm((fitted - self.seen) * self.slopes(fitted)))


_FITS = 2  # the second with the slopes, and the bounds, of the first
_AT_ONCE = 16  # atoms that enter together


def explain(
    bands: Sequence[Observation],
    kept: Sequence[Array] | None = None,
    prior: Array | None = None,
    usable: Mask | None = None,
) -> Array:
    """Return weights v >= 0 of n atoms that explain the observations in every band, shape (B, n), mostly zeros.

    They minimise `sum_r w_r (T(v g_r) - T(seen_r))^2 + (v - s) K (v - s)`. T is the cube root, or the identity for
    rows that are cube roots; `prior` is s (B, n), and `kept` holds K (n, n), the cost of departures from s, for every
    band. Only atoms that are `usable` (n,) get a weight. T is linearised around the fitted values, which gives a
    linear least-squares problem that is solved repeatedly.
    Source: docs/explanation/reconstruction.md.
    """
    weights: Array = np.zeros((len(bands), len(bands[0].atoms)))
    v = weights[:1]
    with one_blas_thread:
        for atoms, run in _runs_of_atoms(bands):
            some, of_prior = bands[run], None
            if kept is not None and prior is not None:
                of_prior = list(zip(kept[run], prior[run], strict=True))
            seen = np.stack([band.seen for band in some])
            fitted = seen if prior is None else prior[run] @ atoms
            v = np.repeat(v[-1:], len(some), axis=0)  # neighbouring bands are alike
            for _ in range(_FITS):
                slopes = np.stack([band.slopes(f) for band, f in zip(some, fitted, strict=True)])
                v = _fit(atoms, seen, slopes**2, v, of_prior, usable)
                fitted = v @ atoms
            weights[run] = v
    return weights


def _runs_of_atoms(bands: Sequence[Observation]) -> Iterator[tuple[Array, slice]]:
    """Yield runs of consecutive bands with the same atoms."""
    start = 0
    for stop in range(1, len(bands) + 1):
        if stop == len(bands) or bands[stop].atoms is not bands[start].atoms:
            yield bands[start].atoms, slice(start, stop)
            start = stop


def _fit(
    A: Array,
    y: Array,
    w: Array,
    start: Array,
    prior: Sequence[tuple[Array, Array]] | None,
    usable: Mask | None,
) -> Array:
    """Return weights v >= 0 (B, n) that minimise `w_b (v_b A - y_b)^2` plus the terms of `explain`, for shared atoms.

    Atoms enter a few at a time, by slopes, which are matrix products for all bands together.
    """
    square, cross, size = w @ (A**2).T, (w * y) @ A.T, np.sum(w * y**2, axis=1)
    for k, (K, s) in enumerate(prior or ()):
        of_prior = K @ s
        square[k] += np.diagonal(K)
        cross[k] += of_prior
        size[k] += s @ of_prior
    norms = np.sqrt(np.maximum(square, np.finfo(float).tiny))
    limit = ROUNDING * np.sqrt(size)
    used, v = start > 0.0, np.zeros_like(start)
    unfinished = np.arange(len(y))
    while unfinished.size:
        left = np.empty((len(unfinished), A.shape[1]))  # remainders of what was seen, weighted
        slopes = cross[unfinished]
        for k, b in enumerate(unfinished.tolist()):
            columns = np.flatnonzero(used[b])
            some = A[columns]
            if columns.size:
                inner = (some * w[b]) @ some.T
                if prior is not None:
                    inner += prior[b][0][np.ix_(columns, columns)]
                v[b, columns] = nonnegative_weights(inner, cross[b][None, columns])[0]
            left[k] = w[b] * (v[b, columns] @ some)
            if prior is not None:
                slopes[k] -= prior[b][0][:, columns] @ v[b, columns]
        slopes = (slopes - left @ A.T) / norms[unfinished]
        slopes[used[unfinished] | (False if usable is None else ~usable)] = 0.0
        enter = np.argsort(-slopes, axis=1)[:, :_AT_ONCE]
        enters = np.take_along_axis(slopes, enter, axis=1) > limit[unfinished, None]
        row, place = np.nonzero(enters)
        used[unfinished[row], enter[row, place]] = True
        unfinished = unfinished[enters.any(axis=1)]
    return v
