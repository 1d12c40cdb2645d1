"""Three errors of left-out materials against the number of readings that they are completed from."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from manifold import __version__
from manifold.errors import UsageError
from manifold.experiments.readings.methods import METHODS, ReadingMethod, Task
from manifold.library.store import Library
from manifold.model.completion.expected import KINDS, errors_of
from manifold.model.completion.samples import LibrarySamples
from manifold.model.completion.suggest import all_directions, directions_of
from manifold.records import Array, Progress

COUNTS = (1, 2, 5, 8, 10, 12, 16, 20, 50)
MA_T12 = "completion at an MA-T12"
_FIXED = "ma_t12"  # its key


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
    library: Library | None = None,
) -> list[Curve]:
    """Complete every material of a library from the others, from n readings, by every method.

    Readings are without noise, in the sample bands. Every method reads where it would have it, among elevations by 10
    degrees to 80 and azimuths by 30; the last curve is the completion at the directions of an MA-T12.

    Args:
        samples: of the library.
        counts: n, increasing.
        only: keys of methods; all by default.
        on_progress: called with (done, total, name).
        library: where materials that are done are kept until all are, so that an interrupted run is continued.
    Raises:
        UsageError: there is no such method.
    """
    known = {method.key: method for method in METHODS}
    missing = [key for key in only if key not in known]
    if missing:
        raise UsageError(f"no method '{missing[0]}', expected one of {', '.join(known)}")
    methods = [known[key] for key in only] if only else list(METHODS)
    N, kinds = len(samples.names), len(KINDS)
    errors = {method.key: np.full((len(counts), N, kinds), np.nan) for method in methods}
    errors[_FIXED] = np.empty((1, N, kinds))
    run = f"readings-1 {__version__} {samples.names} {list(counts)} {list(errors)}"
    done = 0
    if library is not None:
        run = hashlib.sha256(f"{run} {library.content_hash}".encode()).hexdigest()
        if kept := library.cache_get(run):
            done = int(kept.pop("done")[0])
            errors = kept
    places = [(wi, wo, samples.at(wi, wo)) for wi, wo in (all_directions(), directions_of("ma-t12"))]
    for m in range(done, N):
        if on_progress is not None:
            on_progress(m, N, samples.names[m])
        for key, found in _errors_of(samples, m, counts, methods, places).items():
            errors[key][:, m] = found
        if library is not None:
            library.cache_put(run, errors | {"done": np.array([m + 1])})
    if library is not None:
        library.cache_put(run, {})  # the next run begins again
    curves = [Curve(method.key, method.title, tuple(counts), errors[method.key]) for method in methods]
    return [*curves, Curve(_FIXED, MA_T12, (len(places[1][0]),), errors[_FIXED])]


def _errors_of(
    samples: LibrarySamples,
    m: int,
    counts: Sequence[int],
    methods: Sequence[ReadingMethod],
    places: Sequence[tuple[Array, Array, Array]],
) -> dict[str, Array]:
    """Errors of one material, by method: shape (len(counts), 3), NaN where a method needs more readings.

    Args:
        samples: of all materials.
        m: which is left out.
        counts: numbers of readings.
        methods: to be measured.
        places: directions to choose from, then those of an MA-T12, each with the cube roots there.
    """
    own, others = samples.material_of == m, samples.without(m)
    free, fixed = (Task(others, at[~own], at[own], wi, wo) for wi, wo, at in places)
    orders = {choose: choose(free, max(counts)) for choose in {method.order for method in methods}}
    errors = {method.key: np.full((len(counts), len(KINDS)), np.nan) for method in methods}
    for method in methods:
        for k, count in enumerate(counts):
            if count >= method.least:
                chosen = orders[method.order][:count]
                errors[method.key][k] = errors_of(samples, m, *method.predict(free, chosen))
    all_of_them = np.arange(len(fixed.wi))
    errors[_FIXED] = np.array([errors_of(samples, m, *METHODS[0].predict(fixed, all_of_them))])
    return errors
