"""The likelihood after a move of one coordinate of one latent, in O(N^2), for direct local search."""

from __future__ import annotations

import numba as nb
import numpy as np

from manifold.latent.kernels import radial_of_pair
from manifold.latent.objective import LatentObjective
from manifold.records import Array

_LARGEST_DRIFT = 2e-9  # entry of K P - I tolerated before P is computed afresh
# Accepted before P is computed afresh in any case: log|K| and the trace accumulate rounding too.
_MOST_MOVES = 500
_LOG_DET, _TRACE, _SQUARED_NORM, _VALUE, _MOVES = range(5)


class IncrementalObjective:
    """F as a `MoveObjective`: a move of one coordinate of one latent costs O(N^2).

    Moving latent i changes row and column i of K, `K' = K + e_i d^T + d e_i^T` with
    `d_i = 0`. With `P = K^-1`, `p = P e_i`, `q = P d`, `a = p_i`, `b = q_i`, `c = d^T q`
    and `t = (1 + b)^2 - a c`,

        |K'| = t |K|,    P' = P + (c p p^T - (1 + b) (p q^T + q p^T) + a q q^T) / t.

    Every move measures the error of P on the row it changed and on one more; P is computed afresh when that
    exceeds 2e-9, and after 500 moves.

    Args:
        objective: F.
        X: the start, shape (N, Q); copied.
    Attributes:
        n_refactorisations: how often P was computed afresh since the start, jumps not counted.
    Source: Woodbury; Hikichi & Iwasaki, section 3.4, for the search it serves.
    """

    def __init__(self, objective: LatentObjective, X: Array) -> None:
        self.objective = objective
        self.n_refactorisations = 0
        N, self._Q = X.shape
        self._work = np.zeros((4, N))  # d, P d, S P d, S p
        self._state = np.zeros(5)  # log|K|, tr(P S), ||X||^2, F, moves since P was computed
        self._numbers = (*objective.kernel.numbers, float(objective.n_outputs), float(objective.prior))
        self.move_to(X)

    @property
    def x(self) -> Array:
        """The latents as one vector, row by row, shape (N Q,). A view: do not write to it."""
        return self._X.reshape(-1)

    @property
    def value(self) -> float:
        """F here."""
        return float(self._state[_VALUE])

    def move_to(self, x: Array) -> None:
        """Make x (N Q,) the current point, by a fresh factorisation."""
        self._X = np.array(x, dtype=np.float64).reshape(-1, self._Q)
        self._factorise()

    def _factorise(self) -> None:
        self._K = self.objective.kernel.training(self._X)
        self._P, log_det = self.objective.factorise(self._K)
        trace = float(np.sum(self._P * self.objective.S))
        squared_norm = float(np.sum(self._X**2))
        value = self.objective.value_of(log_det, trace, squared_norm)
        self._state[:] = log_det, trace, squared_norm, value, 0

    def move(self, index: int, delta: float) -> float:
        """Move coordinate `index` of x by delta, better or worse, and return F there."""
        i, q = divmod(index, self._Q)
        moved = _try_move(
            self._X,
            self._K,
            self._P,
            self.objective.S,
            self._work,
            self._state,
            self._numbers,
            i,
            q,
            delta,
            False,
        )
        self._renew(
            _make_move(self._X, self._K, self._P, self._work, self._state, i, q, self._X[i, q] + delta, moved)
        )
        return self.value

    def explore(self, steps: Array, heading: Array, limits: tuple[Array, Array], budget: int) -> int:
        """Try every coordinate both ways, keep each improvement at once; see `MoveObjective`."""
        index = tried = 0
        while index < steps.shape[0] and tried < budget:
            index, more, has_drifted = _explore(
                self._X, self._K, self._P, self.objective.S, self._work, self._state, self._numbers,
                steps, heading, *limits, index, budget - tried,
            )  # fmt: skip
            tried += more
            self._renew(has_drifted)
        return tried

    def _renew(self, has_drifted: bool) -> None:
        if has_drifted:
            self.n_refactorisations += 1
            self._factorise()


@nb.njit(cache=True)
def _explore(X, K, P, S, work, state, numbers, steps, heading, lower, upper, index, budget):
    """Explore from coordinate `index` on until P has drifted: the next index, moves tried, whether P has drifted."""
    tried = 0
    while index < steps.shape[0]:
        i, q = divmod(index, X.shape[1])
        here, before, has_drifted = X[i, q], tried, False
        for sense in (heading[index], -heading[index]):
            target = min(max(here + sense * steps[index], lower[index]), upper[index])
            if target == here:
                continue
            if tried == budget:
                return index, tried, False
            moved = _try_move(X, K, P, S, work, state, numbers, i, q, target - here, tried > before)
            tried += 1
            if moved[-1] < state[_VALUE]:
                heading[index] = sense
                has_drifted = _make_move(X, K, P, work, state, i, q, target, moved)
                break
        index += 1
        if has_drifted:
            return index, tried, True
    return index, tried, False


@nb.njit(cache=True)
def _try_move(X, K, P, S, work, state, numbers, i, q, delta, cached):
    """Latent i moved by delta along axis q: t, a, b and c; log|K|, tr(P S), ||X||^2 and F there.

    Leaves d, P d and S P d in `work`, and S P e_i, which moves of the same latent share (`cached`).
    """
    N, Q = X.shape
    family, inverse_l2, n_outputs, prior = numbers
    d, Pd, SPd, Sp = work[0], work[1], work[2], work[3]
    for j in range(N):
        squared = 0.0
        for k in range(Q):
            moved = X[i, k] + delta if k == q else X[i, k]
            squared += (moved - X[j, k]) ** 2
        d[j] = radial_of_pair(family, squared * inverse_l2) - K[i, j]
        Pd[j] = 0.0
        SPd[j] = 0.0
    d[i] = 0.0
    for j in range(N):  # symmetric: rows serve as columns, and the inner loop runs along memory
        w = d[j]
        for k in range(N):
            Pd[k] += w * P[j, k]
    for j in range(N):
        w = Pd[j]
        for k in range(N):
            SPd[k] += w * S[j, k]
    if not cached:
        Sp[:] = 0.0
        for j in range(N):
            w = P[i, j]
            for k in range(N):
                Sp[k] += w * S[j, k]
    a, b, c = P[i, i], Pd[i], 0.0
    pSp, pSq, qSq = 0.0, 0.0, 0.0
    for j in range(N):
        c += d[j] * Pd[j]
        pSp += P[i, j] * Sp[j]
        pSq += Pd[j] * Sp[j]
        qSq += Pd[j] * SPd[j]
    t = (1.0 + b) * (1.0 + b) - a * c
    if not t > 0.0:  # rounding: no real move makes K indefinite
        return t, a, b, c, np.nan, np.nan, np.nan, np.inf
    log_det = state[_LOG_DET] + np.log(t)
    trace = state[_TRACE] + (c * pSp - 2.0 * (1.0 + b) * pSq + a * qSq) / t
    squared_norm = state[_SQUARED_NORM] + delta * (2.0 * X[i, q] + delta)
    if not trace > 0.0:
        return t, a, b, c, log_det, trace, squared_norm, np.inf
    value = 0.5 * (log_det + N * np.log(trace / (N * n_outputs)) + prior * squared_norm)
    return t, a, b, c, log_det, trace, squared_norm, value


@nb.njit(cache=True)
def _make_move(X, K, P, work, state, i, q, target, moved):
    """Make a move in place; whether rows i and another of K P - I show that P has drifted."""
    N = K.shape[0]
    d, Pd, p = work[0], work[1], work[2]
    t, a, b, c = moved[:4]
    X[i, q] = target
    for k in range(4):  # a slice's shape would be checked: the message alone takes seconds to compile
        state[k] = moved[4 + k]
    state[_MOVES] += 1
    for j in range(N):
        p[j] = P[i, j]
    for j in range(N):
        along_p = (c * p[j] - (1.0 + b) * Pd[j]) / t
        along_q = (a * Pd[j] - (1.0 + b) * p[j]) / t
        for k in range(N):
            P[j, k] += along_p * p[k] + along_q * Pd[k]
        K[i, j] += d[j]
        K[j, i] = K[i, j]
    drift = 0.0
    for row in (i, int(state[_MOVES]) % N):
        residual = work[3]
        residual[:] = 0.0
        residual[row] = -1.0
        for j in range(N):
            w = K[row, j]
            for k in range(N):
                residual[k] += w * P[j, k]
        for k in range(N):
            if not abs(residual[k]) <= drift:  # NaN counts as drift
                drift = abs(residual[k])
    return not drift < _LARGEST_DRIFT or state[_MOVES] >= _MOST_MOVES
