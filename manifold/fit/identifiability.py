"""Computes the standard errors of fitted parameters, and whether the data determine the parameters at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from manifold.core.records import Array, Mask
from manifold.fit.gauss_newton import GaussNewton, Minimum, Residuals, minimize
from manifold.render.bsdf_parameters import FreeParameter, ParameterLayout

DETERMINED = "determined"
UNCERTAIN = "uncertain"
UNSEEN = "not seen"
AMBIGUOUS = "ambiguous"

_CONFIDENCE = 0.99  # confidence at which a second minimum counts as worse than the best
BOUND = 2e-3
"""Share of a range: values nearer to an end count as the end; a lobe of such a weight is none."""

_CORRELATED = 0.9  # correlation of two undetermined parameters from which the other one is named
_STEP = 0.1  # share of every range: how far a linear model is trusted


@dataclass(frozen=True)
class ParameterIdentifiability:
    """Identifiability of one parameter, or of its value in one band.

    Attributes:
        name: name of the parameter, with the index of the band if there are several.
        value: the fitted value.
        standard_error: standard error of the value, at most that of a uniform distribution over the range.
        state: `determined` (twice the standard error is within the parameter's tolerance), `uncertain`,
            `not seen` (the samples hardly depend on it), or `ambiguous` (another minimum, as good within the
            noise, has a different value).
        at_bound: whether the value is at an end of its range.
        entangled_with: the parameter with which it is most correlated, if the correlation exceeds 0.9 and the
            parameter is not determined; otherwise None.
        is_kept: whether the parameter was left at the BSDF's default, because the samples do not determine it.
    """

    name: str
    value: float
    standard_error: float
    state: str
    at_bound: bool
    entangled_with: str | None
    is_kept: bool = False

    def __str__(self) -> str:
        text = f"{self.value:.3f} +- {self.standard_error:.3f}, {self.state}"
        if self.entangled_with is not None:
            text += f" (correlated with {self.entangled_with})"
        return text + ", left at its default" * self.is_kept + ", at the end of its range" * self.at_bound


def residual_variance(residual: Array, n_parameters: int, floor: float) -> float:
    """Return the variance of a residual in a fit of n parameters, at least `floor`, the variance of assumed noise."""
    freedom = max(residual.size - n_parameters, 1)
    return max(float(residual @ residual) / freedom, floor)


def as_good_limit(variance: float, n_parameters: int) -> float:
    """Return the largest difference of two costs that noise of this variance can explain (chi-square test at 99 %)."""
    return variance * float(chi2.ppf(_CONFIDENCE, n_parameters))


def gauss_newton_step(layout: ParameterLayout, p: Array, residual: Array, J: Array) -> tuple[Array, float]:
    """Return the step (K,) of one Gauss-Newton iteration, at most a tenth of any range, and its predicted cost.

    It uses the residuals (n,) and their derivatives J (n, K).
    """
    span = layout.maximum - layout.minimum
    room = np.array([layout.minimum - p, layout.maximum - p]) / span
    low, high = np.clip(room, -_STEP, _STEP)
    found = lsq_linear(
        J * span, -residual, (low - 1e-9, high + 1e-9)
    )  # a value at an end needs some room too
    return found.x * span, 2.0 * float(found.cost)


def is_different(
    layout: ParameterLayout, p: Array, other: Array, statements: Sequence[ParameterIdentifiability]
) -> bool:
    """Return whether other values (K,) differ from p in a parameter that the samples determine.

    The difference must exceed both the standard error and the tolerance.
    """
    error = np.array([s.standard_error for s in statements])
    is_seen = np.array([s.state != UNSEEN for s in statements])
    apart = np.abs(other - p) > 2.0 * np.maximum(error, layout.tolerance)
    return bool(np.any(apart & is_seen))


def identify_parameters(
    layout: ParameterLayout,
    p: Array,
    J: Array,
    variance: float,
    alternatives: list[Array],
    kept: Mask,
) -> tuple[ParameterIdentifiability, ...]:
    """Return the identifiability of all K fitted values, from the derivatives J (n, K) and variance of the residuals.

    `alternatives` are other values, each (K,), that fit as well within the noise; `kept` (K,) marks values left at
    their defaults. The covariance is `(J^T J / variance + I / prior)^-1`. The prior variance is that of a uniform
    distribution over the range, which keeps the variance finite in directions that the samples do not determine.
    """
    span = layout.maximum - layout.minimum
    prior = span / np.sqrt(12.0)
    scaled = J * prior  # unit prior
    precision = scaled.T @ scaled / variance + np.eye(layout.size)
    covariance = np.linalg.inv(precision)
    unit_error = np.sqrt(np.diag(covariance))
    correlation = np.abs(covariance / np.outer(unit_error, unit_error))
    np.fill_diagonal(correlation, 0.0)
    made = []
    for k, label in enumerate(layout.labels):
        error = float(unit_error[k] * prior[k])
        moved = any(
            abs(other[k] - p[k]) > max(2.0 * error, 2.0 * layout.tolerance[k]) for other in alternatives
        )
        if unit_error[k] > 0.8:
            state = UNSEEN
        elif moved:
            state = AMBIGUOUS
        elif 2.0 * error <= layout.tolerance[k]:
            state = DETERMINED
        else:
            state = UNCERTAIN
        partner = int(np.argmax(correlation[k]))
        entangled = state != DETERMINED and correlation[k, partner] > _CORRELATED
        made.append(
            ParameterIdentifiability(
                name=label,
                value=float(p[k]),
                standard_error=error,
                state=state,
                at_bound=not kept[k]
                and bool(min(p[k] - layout.minimum[k], layout.maximum[k] - p[k]) < BOUND * span[k]),
                entangled_with=layout.labels[partner] if entangled else None,
                is_kept=bool(kept[k]),
            )
        )
    return tuple(made)


@dataclass(frozen=True, eq=False)
class TriedDefaults:
    """A record of which of K values were set to their defaults for a trial.

    Attributes:
        kept: whether the value stays at its default, because the fit is as good, bool (K,).
        refused: whether the fit was worse at the default, so that the samples do depend on the value, bool (K,).
    """

    kept: Mask
    refused: Mask

    @classmethod
    def none(cls, size: int) -> TriedDefaults:
        """Return a record without any trial."""
        return cls(np.zeros(size, bool), np.zeros(size, bool))


def keep_undetermined(
    residuals: Residuals,
    best: Minimum,
    statements: tuple[ParameterIdentifiability, ...],
    limit: float,
    options: GaussNewton,
) -> tuple[Minimum, TriedDefaults]:
    """Set undetermined values to their defaults if that costs nothing, and refine the others again.

    Returns the best minimum, and a record of the trials.

    A value is undetermined if the samples hardly depend on it, or if it is uncertain and is at a bound other than its
    default. The values are set to their defaults one after the other, the least certain first. A value stays at its
    default if the cost increases by less than `limit`, which noise can explain.
    """
    layout = residuals.layout
    owners = layout.owner
    tried, found = TriedDefaults.none(layout.size), best
    open_ends = [
        k
        for k, s in enumerate(statements)
        if owners[k].undetermined is not None
        and (s.state == UNSEEN or (s.state == UNCERTAIN and s.at_bound and _is_moved(s, owners[k])))
    ]
    for k in sorted(open_ends, key=lambda k: -statements[k].standard_error / owners[k].range):
        kept = tried.kept | (np.arange(layout.size) == k)
        if np.all(kept):
            break
        start = found.p.copy()
        start[k] = owners[k].undetermined
        trial = minimize(residuals, start, options.iterations, options.tolerance, kept=kept)
        if trial.cost - best.cost <= limit:
            tried.kept[k], found = True, trial
        else:
            tried.refused[k] = True
    return found, tried


def _is_moved(statement: ParameterIdentifiability, parameter: FreeParameter) -> bool:
    """Return whether a value differs from its default."""
    return abs(statement.value - (parameter.undetermined or 0.0)) > parameter.tolerance
