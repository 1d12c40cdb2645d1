"""Checks a completion by predicting each reading from the other readings of the same material."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.core.metrics import Errors
from manifold.core.records import Array
from manifold.estimate.completion import Completion
from manifold.estimate.residual import coordinates

MOST_READINGS = 30
"""Largest number of readings for which each is left out in turn; each takes about 0.1 s."""


@dataclass(frozen=True, eq=False)
class LeftOutReadings:
    """Errors of predicting each reading from the others.

    Attributes:
        relative: relative cube-root errors over the bands of the reading, shape (P,).
        ciede2000: CIEDE2000 under the light and observer of `Completion.viewing`, shape (P,); None if readings have
            no colour.
    """

    relative: Array
    ciede2000: Array | None

    @property
    def typical(self) -> Errors[float]:
        """Medians: CIEDE2000 as `ball` (NaN without colours), cube-root error as `cube_root` and `elsewhere`."""
        ball = np.nan if self.ciede2000 is None else float(np.median(self.ciede2000))
        relative = float(np.median(self.relative))
        return Errors(ball=ball, cube_root=relative, elsewhere=relative)


def left_out_readings(completion: Completion) -> LeftOutReadings | None:
    """Predict each reading from the completion of the others.

    Returns None if there are pictures, a single reading, or more than `MOST_READINGS` readings.
    """
    evidence = completion.evidence
    if evidence.pictures or not 2 <= len(completion.readings) <= MOST_READINGS:
        return None
    readings, at, at_gloss = evidence.read
    rows = []
    for k in range(len(readings)):
        others = np.arange(len(readings)) != k
        rest = replace(evidence, readings=readings.select_pairs(others), at=(at[:, others], at_gloss))
        solution = Completion.of(completion.atoms, rest).solution
        assert solution.factors is not None
        factors = solution.factors.at(coordinates(readings.wi[[k]], readings.wo[[k]]))
        rows.append((solution.weights @ at[:, [k]] * factors).T[0] ** 3)
    predicted = np.array(rows)
    read = np.maximum(np.where(readings.measured, readings.values, predicted), 0.0)
    roots, off = np.cbrt(read), np.cbrt(read) - np.cbrt(np.maximum(predicted, 0.0))
    norm = np.maximum(np.linalg.norm(roots, axis=1), np.finfo(float).tiny)
    if completion.colours is None:
        return LeftOutReadings(np.linalg.norm(off, axis=1) / norm, None)
    of_read, of_predicted = (
        lab_values(values, readings.bands, completion.viewing) for values in (read, predicted)
    )
    return LeftOutReadings(np.linalg.norm(off, axis=1) / norm, delta_e_2000_lab(of_read, of_predicted))
