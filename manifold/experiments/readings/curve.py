"""Three errors of left-out materials against the number of readings that they are completed from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from manifold import __version__
from manifold.errors import UsageError
from manifold.experiments.interrupted import KeptResults
from manifold.experiments.readings.methods import METHODS, ReadingMethod, Task
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.model.completion.expected import KINDS, completion_errors, errors_of, leave_out
from manifold.model.completion.samples import LibrarySamples
from manifold.model.completion.suggest import all_directions, directions_of
from manifold.records import Array, Progress

COUNTS = (1, 2, 5, 8, 10, 12, 16, 20, 50)
_MA_T12 = "completion at an MA-T12"
_FIXED: dict[str, tuple[str, tuple[float, ...]]] = {
    "ma_t12": (_MA_T12, ()),
    "ma_t12_gloss": (f"{_MA_T12}, with gloss at 20 and 60 degrees", (20.0, 60.0)),
}  # title, and angles of gloss, by key


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
    on_result: Callable[[list[Curve]], None] | None = None,
) -> list[Curve]:
    """Complete every material of a library from the others, from n readings, by every method.

    Readings are without noise, in the sample bands. Every method reads where it would have it, among elevations by 10
    degrees to 80 and azimuths by 30; the last curves are the completion at the directions of an MA-T12, without gloss
    and with it.

    Args:
        samples: of the library.
        counts: n, increasing.
        only: keys of methods; all by default.
        on_progress: called with (done, total, name).
        library: where materials that are done are kept until all are and `on_result` has returned, so that an
            interrupted run is continued.
        on_result: called with the curves, to write them.
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
    errors |= {key: np.empty((1, N, kinds)) for key in _FIXED}
    kept = KeptResults(library, f"readings-2 {samples.names} {list(counts)} {list(errors)}")
    errors |= kept.get()
    done = int(errors.pop("done", np.zeros(1))[0])
    wi, wo = all_directions()
    at, fixed = samples.at(wi, wo), _fixed_readings(samples)
    for m in range(done, N):
        if on_progress is not None:
            on_progress(m, N, samples.names[m])
        for key, found in _errors_of(samples, m, counts, methods, (wi, wo, at), fixed).items():
            errors[key][:, m] = found
        kept.put(errors | {"done": np.array([m + 1])})
    curves = [Curve(method.key, method.title, tuple(counts), errors[method.key]) for method in methods]
    curves += [
        Curve(key, title, (len(fixed[key][1]) + len(angles),), errors[key])
        for key, (title, angles) in _FIXED.items()
    ]
    if on_result is not None:
        on_result(curves)
    kept.finish()
    return curves


def _fixed_readings(samples: LibrarySamples) -> dict[str, tuple[Array, Readings, Array]]:
    """Readings at fixed directions, of which values do not matter, by key, as `leave_out` takes them."""
    wi, wo = directions_of("ma-t12")
    at, nm = samples.at(wi, wo), samples.bands.wavelengths_nm
    blank = Readings(
        "left out", "library", wi, wo, None if nm is None else np.array(nm),
        np.ones((len(wi), samples.bands.count)),
    )  # fmt: skip
    return {
        key: (at, replace(blank, gloss=dict.fromkeys(angles, 1.0)), samples.gloss(angles))
        for key, (_, angles) in _FIXED.items()
    }


def _errors_of(
    samples: LibrarySamples,
    m: int,
    counts: Sequence[int],
    methods: Sequence[ReadingMethod],
    candidates: tuple[Array, Array, Array],
    fixed: Mapping[str, tuple[Array, Readings, Array]],
) -> dict[str, Array]:
    """Errors of one material, by method: shape (len(counts), 3), NaN where a method needs more readings.

    Args:
        samples: of all materials.
        m: which is left out.
        counts: numbers of readings.
        methods: to be measured.
        candidates: wi and wo of directions to choose from, and cube roots of samples there.
        fixed: see `_fixed_readings`.
    """
    wi, wo, at = candidates
    own, others = samples.material_of == m, samples.without(m)
    task = Task(others, at[~own], at[own], wi, wo)
    orders = {choose: choose(task, max(counts)) for choose in {method.order for method in methods}}
    errors = {method.key: np.full((len(counts), len(KINDS)), np.nan) for method in methods}
    for method in methods:
        for k, count in enumerate(counts):
            if count >= method.least:
                chosen = orders[method.order][:count]
                errors[method.key][k] = errors_of(samples, m, *method.predict(task, chosen))
    return errors | {
        key: np.array([completion_errors(samples, m, leave_out(samples, m, *read))])
        for key, read in fixed.items()
    }
