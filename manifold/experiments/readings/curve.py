"""Three errors of left-out materials against the number of readings that they are completed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from manifold import __version__
from manifold.errors import UsageError
from manifold.experiments.readings.methods import METHODS, Task
from manifold.model.completion.expected import KINDS, errors_of
from manifold.model.completion.samples import LibrarySamples
from manifold.model.completion.suggest import all_directions, directions_of
from manifold.records import Array, Progress

COUNTS = (1, 2, 5, 8, 10, 12, 16, 20, 50)
MA_T12 = "completion at an MA-T12"


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors of one method.

    Attributes:
        key, title: of the method.
        counts: numbers of readings.
        errors: ball CIEDE2000, cube root and linear of every left-out material, shape (len(counts), N, 3).
    """

    key: str
    title: str
    counts: tuple[int, ...]
    errors: Array

    def summary(self, k: int) -> list[tuple[float, float]]:
        """Median and 90th percentile at `counts[k]`, error by error."""
        return [
            (float(np.nanmedian(column)), float(np.nanpercentile(column, 90))) for column in self.errors[k].T
        ]

    def is_measured(self, k: int) -> bool:
        """Whether any material has errors at `counts[k]`."""
        return not bool(np.isnan(self.errors[k]).all())

    def to_json(self) -> dict[str, Any]:
        """Plain values; None where a method has no error."""
        errors = self.errors.astype(object)
        errors[np.isnan(self.errors)] = None
        return {
            "key": self.key, "title": self.title, "counts": list(self.counts), "kinds": list(KINDS),
            "errors": errors.tolist(), "program": f"manifold {__version__}",
        }  # fmt: skip


def measure_curves(
    samples: LibrarySamples,
    counts: Sequence[int] = COUNTS,
    only: Sequence[str] = (),
    on_progress: Progress | None = None,
) -> list[Curve]:
    """Complete every material of a library from the others, from n readings, by every method.

    Readings are without noise, in the sample bands. Every method reads where it would have it, among elevations by 10
    degrees to 80 and azimuths by 30; the last curve is the completion at the directions of an MA-T12.

    Args:
        samples: of the library.
        counts: n, increasing.
        only: keys of methods; all by default.
        on_progress: called with (done, total, name).
    Raises:
        UsageError: there is no such method.
    """
    known = {method.key: method for method in METHODS}
    missing = [key for key in only if key not in known]
    if missing:
        raise UsageError(f"no method '{missing[0]}', expected one of {', '.join(known)}")
    methods = [known[key] for key in only] if only else list(METHODS)
    wi, wo = all_directions()
    at = samples.at(wi, wo)
    fixed = directions_of("ma-t12")
    at_fixed = samples.at(*fixed)
    N, kinds = len(samples.names), len(KINDS)
    errors = {method.key: np.full((len(counts), N, kinds), np.nan) for method in methods}
    of_fixed = np.empty((1, N, kinds))
    for m, name in enumerate(samples.names):
        if on_progress is not None:
            on_progress(m, N, name)
        own, others = samples.material_of == m, samples.without(m)
        task = Task(others, at[~own], at[own], wi, wo)
        orders = {choose: choose(task, max(counts)) for choose in {method.order for method in methods}}
        for method in methods:
            order = orders[method.order]
            for k, count in enumerate(counts):
                if count >= method.least:
                    errors[method.key][k, m] = errors_of(samples, m, *method.predict(task, order[:count]))
        task = Task(others, at_fixed[~own], at_fixed[own], *fixed)
        of_fixed[0, m] = errors_of(samples, m, *METHODS[0].predict(task, np.arange(len(fixed[0]))))
    curves = [Curve(method.key, method.title, tuple(counts), errors[method.key]) for method in methods]
    return [*curves, Curve("ma_t12", MA_T12, (len(fixed[0]),), of_fixed)]
