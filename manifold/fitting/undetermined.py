"""Parameters that the samples do not determine keep the defaults of the BSDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.fitting.bsdf_parameters import FreeParameter
from manifold.fitting.gauss_newton import GaussNewton, Minimum, Residuals, minimize
from manifold.fitting.identifiability import UNCERTAIN, UNSEEN, ParameterIdentifiability
from manifold.records import Mask


@dataclass(frozen=True, eq=False)
class TriedDefaults:
    """Which of K values were set to their defaults.

    Attributes:
        kept: left there, since the fit is as good; bool (K,).
        refused: the fit was worse; bool (K,). The samples do see these.
    """

    kept: Mask
    refused: Mask

    @classmethod
    def none(cls, size: int) -> TriedDefaults:
        """Nothing was tried."""
        return cls(np.zeros(size, bool), np.zeros(size, bool))


def keep_undetermined(
    residuals: Residuals,
    best: Minimum,
    statements: tuple[ParameterIdentifiability, ...],
    limit: float,
    options: GaussNewton,
) -> tuple[Minimum, TriedDefaults]:
    """The best minimum with undetermined values at their defaults, where that costs nothing, the others refined again.

    Undetermined is what the samples do not see, and what is uncertain and ended at an end of its range that is not its
    default. One after the other, the least certain first, is set to its default; it stays there where the fit is as
    good within the noise.

    Args:
        residuals: of all samples.
        best: the best minimum.
        statements: of its K values.
        limit: difference of two costs that noise may hide.
        options: of the refinements.
    Returns:
        The minimum, and what became of the values that were set to defaults.
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
    """Whether a value is not its default anyway."""
    return abs(statement.value - (parameter.undetermined or 0.0)) > parameter.tolerance
