"""Where methods fail, and whether they say so: trials of a catalogue of failure modes, judged by what happened.

A mode makes its inputs by severity and runs every method that it concerns on them. A trial measures an error, and keeps
what the package said of its own accord: an error of `manifold.errors` is a refusal; a warning or a diagnostic is a
warning. An error above the mode's threshold about which nothing was said is *silently wrong*: a defect of the package.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from manifold import __version__
from manifold.errors import ManifoldError, UsageError
from manifold.experiments.stability.bench import Bench
from manifold.records import Progress

FINE, WARNED, REFUSED, WRONG = OUTCOMES = ("fine", "warned", "refused", "silently wrong")


@dataclass(frozen=True)
class Found:
    """What a trial measured.

    Attributes:
        error: what the mode's `number` says, at least 0; not finite where a method gave no usable number.
        said: diagnostics and flags that came with the result.
    """

    error: float
    said: tuple[str, ...] = ()


Trial = Callable[[Bench, float], Found]
"""From what the catalogue works on and a severity to what was measured; a ManifoldError is a refusal."""


@dataclass(frozen=True)
class Mode:
    """One way to fail.

    Attributes:
        key: name.
        concerns: what is done to a method, in a few words.
        severity: what the severities are, with their unit.
        severities: from harmless to severe.
        number: what is measured.
        threshold: of the number; above it a result is wrong.
        methods: what is tried, by name.
        advice: what a user should do, in one sentence.
    """

    key: str
    concerns: str
    severity: str
    severities: tuple[float, ...]
    number: str
    threshold: float
    methods: Mapping[str, Trial]
    advice: str


@dataclass(frozen=True)
class Tried:
    """One trial, judged.

    Attributes:
        severity: of the mode.
        error: None where the method refused.
        outcome: one of `OUTCOMES`.
        said: the first thing that was said, else empty.
    """

    severity: float
    error: float | None
    outcome: str
    said: str = ""


@dataclass(frozen=True)
class Row:
    """A method under a mode.

    Attributes:
        mode: key of the mode.
        method: name.
        threshold: of the mode.
        tried: by severity.
    """

    mode: str
    method: str
    threshold: float
    tried: tuple[Tried, ...]

    @property
    def unsaid_error(self) -> float | None:
        """The largest error about which nothing was said; None where something always was."""
        unsaid = [one.error for one in self.tried if one.outcome in (FINE, WRONG) and one.error is not None]
        return max(unsaid, default=None)

    @property
    def is_wrong(self) -> bool:
        """Whether any trial was silently wrong."""
        return any(one.outcome == WRONG for one in self.tried)


@dataclass(frozen=True)
class Stability:
    """The catalogue, tried.

    Attributes:
        rows: mode by mode, method by method.
    """

    rows: tuple[Row, ...]

    @property
    def wrong(self) -> tuple[Row, ...]:
        """Rows with a trial that was silently wrong."""
        return tuple(row for row in self.rows if row.is_wrong)

    def to_json(self, modes: Sequence[Mode]) -> dict[str, Any]:
        """Plain values, with what the modes are; numbers that are not finite become None."""
        rows = [asdict(row) | {"unsaid_error": _finite(row.unsaid_error)} for row in self.rows]
        for row in rows:
            row["tried"] = [one | {"error": _finite(one["error"])} for one in row["tried"]]
        tried = {row.mode for row in self.rows}
        return {
            "program": f"manifold {__version__}",
            "modes": [
                {k: v for k, v in vars(mode).items() if k != "methods"} for mode in modes if mode.key in tried
            ],
            "rows": rows,
        }


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def chosen(modes: Sequence[Mode], only: Sequence[str]) -> tuple[Mode, ...]:
    """The modes named, in the order of the catalogue; all where none is.

    Raises:
        UsageError: a name is unknown.
    """
    known = {mode.key for mode in modes}
    unknown = [name for name in only if name not in known]
    if unknown:
        raise UsageError(
            f"no failure mode is called '{unknown[0]}'; expected one of {', '.join(sorted(known))}"
        )
    return tuple(mode for mode in modes if not only or mode.key in only)


def try_modes(modes: Sequence[Mode], on_progress: Progress | None = None) -> Stability:
    """Run every method of every mode at every severity.

    Args:
        modes: what to try.
        on_progress: called with (done, total, what) after each method.
    """
    rows: list[Row] = []
    total = sum(len(mode.methods) for mode in modes)
    with (
        Bench() as bench,
        threadpool_limits(1, "blas"),
    ):  # a dozen materials: sharing out costs more than it gains
        for mode in modes:
            for method, trial in mode.methods.items():
                tried = tuple(try_once(trial, bench, s, mode.threshold) for s in mode.severities)
                rows.append(Row(mode.key, method, mode.threshold, tried))
                if on_progress is not None:
                    on_progress(len(rows), total, f"{mode.key}: {method}")
    return Stability(tuple(rows))


def try_once(trial: Trial, bench: Bench, severity: float, threshold: float) -> Tried:
    """Run a trial and judge it by its error and by what was said.

    What breaks off without an error of this package is silently wrong: nobody was told what to do.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = trial(bench, severity)
        except ManifoldError as error:
            return Tried(severity, None, REFUSED, str(error))
        except Exception as error:
            return Tried(severity, None, WRONG, f"{type(error).__name__}: {error}")
    ours = [str(one.message) for one in caught if one.category.__module__.startswith("manifold")]
    said = [*ours, *found.said]
    if said:
        return Tried(severity, found.error, WARNED, said[0])
    is_right = found.error <= threshold  # not for NaN
    return Tried(severity, found.error, FINE if is_right else WRONG)
