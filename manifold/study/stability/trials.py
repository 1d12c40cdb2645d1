"""Runs trials of failure modes, and classifies whether failures are detected.

A mode makes inputs of rising severity, and runs the methods that it concerns on them. A trial measures an error and
collects the messages of the package: an error of `manifold.core.errors` is a refusal; a warning, a diagnostic or a
note is a warning. An error above the mode's limit without any message is *silently wrong*; a warning or a refusal at
the first severity, which is harmless, is a *false alarm*. Both are defects of the package. Methods that cannot run on
this machine are left out.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

from manifold.core import progress, work
from manifold.core.errors import ManifoldError, RendererError
from manifold.core.records import plain
from manifold.registries import Registry
from manifold.study.stability.testbed import TestBed

FINE, WARNED, REFUSED, WRONG = OUTCOMES = ("fine", "warned", "refused", "silently wrong")


@dataclass(frozen=True)
class Measurement:
    """The error of one result of a trial, and the messages that came with it.

    Attributes:
        error: the error that is compared with the limit of the failure mode, at least 0; not finite if a method gave no
            usable number.
        messages: diagnostics and notes that came with the result.
    """

    error: float
    messages: tuple[str, ...] = ()


Trial = Callable[[TestBed, float], Measurement | Sequence[Measurement]]
"""A function of the test bed and a severity that returns one measurement or several.

A ManifoldError is a refusal, but a RendererError says that the method cannot run on this machine.
"""


@dataclass(frozen=True)
class Limit:
    """The largest acceptable error: the measured quantity, its limit, and the reason for the limit."""

    quantity: str
    value: float
    reason: str


HALF_OF_NEAREST = Limit(
    "error of a left-out plastic, relative to that of the nearest material",
    0.5,
    "a manifold should at least halve the error of the nearest material",
)
BALL = Limit(
    "CIEDE2000 (studio 180) between the balls of prediction and ground truth",
    5.0,
    "an observer sees two different colours (Mokrzycki & Tatol 2011); chosen after the results were known",
)
SAME_RESULT = Limit(
    "relative difference of the prediction",
    0.01,
    "the repeatability of instruments is no better",
)


@dataclass(frozen=True)
class Mode:
    """A failure mode: a way in which results become wrong.

    Attributes:
        concerns: the cause of the failure, in a few words.
        severity, severities: meaning and unit of the severities, and their values from harmless to severe.
        limit: limit of the error.
        methods: the methods that are tried, by name.
        advice: advice for the user, in one sentence.
        known: methods that are known to be silently wrong at some severity.
    """

    key: str
    concerns: str
    severity: str
    severities: tuple[float, ...]
    limit: Limit
    methods: Mapping[str, Trial]
    advice: str
    known: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrialResult:
    """The result of a method at one severity of a mode.

    Attributes:
        error: the largest error; None if the method gave no result.
        undetected_error: the largest error without a message; None if every result had one.
        outcome: one of `OUTCOMES`.
        message: the first message; empty if there was none.
    """

    severity: float
    error: float | None
    undetected_error: float | None
    outcome: str
    message: str = ""


@dataclass(frozen=True)
class Row:
    """The results of one method under one failure mode, by severity, with both names and the mode's error limit."""

    mode: str
    method: str
    limit: float
    results: tuple[TrialResult, ...]

    @property
    def undetected_error(self) -> float | None:
        """The largest error without a message; None if every result had one."""
        errors = [one.undetected_error for one in self.results if one.undetected_error is not None]
        return max(errors, default=None)

    @property
    def is_wrong(self) -> bool:
        """Return whether any trial was silently wrong."""
        return any(one.outcome == WRONG for one in self.results)

    @property
    def is_false_alarm(self) -> bool:
        """Return whether the first, harmless severity caused a warning or a refusal."""
        return self.results[0].outcome in (WARNED, REFUSED)


@dataclass(frozen=True)
class Stability:
    """The results of all methods under all modes.

    Attributes:
        rows: mode by mode, method by method.
        skipped: why a method could not run on this machine, by mode and method.
    """

    rows: tuple[Row, ...]
    skipped: Mapping[str, str] = field(default_factory=dict)

    @property
    def wrong(self) -> tuple[Row, ...]:
        """Rows with a trial that was silently wrong."""
        return tuple(row for row in self.rows if row.is_wrong)

    @property
    def false_alarms(self) -> tuple[Row, ...]:
        """Rows whose first, harmless severity caused a warning or a refusal."""
        return tuple(row for row in self.rows if row.is_false_alarm)

    @property
    def early_warnings(self) -> int:
        """Number of trials with a warning although their error was within the limit."""
        trials = [(one, row.limit) for row in self.rows for one in row.results]
        return sum(
            one.outcome == WARNED and one.error is not None and one.error <= limit for one, limit in trials
        )

    def to_json(self, modes: Sequence[Mode]) -> dict[str, Any]:
        """Return plain values, with descriptions of the modes; numbers that are not finite become None."""
        tried = {row.mode for row in self.rows}
        known = {
            "silently_wrong": len(self.wrong),
            "false_alarms": len(self.false_alarms),
            "early_warnings": self.early_warnings,
            "modes": [
                {key: value for key, value in vars(mode).items() if key != "methods"}
                for mode in modes
                if mode.key in tried
            ],
            "rows": [
                vars(row) | {"undetected_error": row.undetected_error, "is_false_alarm": row.is_false_alarm}
                for row in self.rows
            ],
            "skipped": self.skipped,
        }
        return plain(known)


def select_modes(modes: Sequence[Mode], only: Sequence[str]) -> tuple[Mode, ...]:
    """Return the named modes, in the order of the catalogue; all if none is named."""
    known = Registry("failure mode", ((mode.key, mode) for mode in modes))
    wanted = [known[name] for name in only]
    return tuple(mode for mode in modes if not only or mode in wanted)


def run_modes(modes: Sequence[Mode], workers: Executor | None = None) -> Stability:
    """Run every method of every mode at every severity; each worker makes its own test bed."""
    tasks = [(mode, method) for mode in modes for method in mode.methods]
    found: dict[int, Row | str] = {}
    with TestBed() as bed:
        run = partial(_run_method, bed=bed) if workers is None else _run_method
        for k, row, failure in work.run(run, tasks, workers):
            found[k] = str(failure) if row is None else row
            progress.report(len(found), len(tasks), f"{tasks[k][0].key}: {tasks[k][1]}")
    rows = tuple(row for _, row in sorted(found.items()) if isinstance(row, Row))
    skipped = {
        f"{tasks[k][0].key}: {tasks[k][1]}": why for k, why in sorted(found.items()) if isinstance(why, str)
    }
    return Stability(rows, skipped)


def _run_method(task: tuple[Mode, str], bed: TestBed | None = None) -> Row:
    """Return the results of a method. Raises RendererError if it cannot run on this machine."""
    mode, method = task
    bed = bed or _bed_of_worker()
    results = tuple(run_trial(mode, method, bed, severity) for severity in mode.severities)
    return Row(mode.key, method, mode.limit.value, results)


@lru_cache(maxsize=1)
def _bed_of_worker() -> TestBed:
    return TestBed()


def run_trial(mode: Mode, method: str, bed: TestBed, severity: float) -> TrialResult:
    """Run a method at a severity and classify it by its errors and its messages.

    An exception that is not one of this package's errors counts as silently wrong.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = mode.methods[method](bed, severity)
        except RendererError:
            raise
        except ManifoldError as error:
            return TrialResult(severity, None, None, REFUSED, str(error))
        except Exception as error:
            return TrialResult(severity, None, None, WRONG, f"{type(error).__name__}: {error}")
    measured = [found] if isinstance(found, Measurement) else list(found)
    ours = [str(one.message) for one in caught if one.category.__module__.startswith("manifold")]
    messages = [*ours, *(text for one in measured for text in one.messages)]
    silent = [] if ours else [one.error for one in measured if not one.messages]
    is_right = all(error <= mode.limit.value for error in silent)  # not for NaN
    return TrialResult(
        severity,
        max(one.error for one in measured),
        max(silent, default=None),
        WRONG if not is_right else WARNED if messages else FINE,
        messages[0] if messages else "",
    )
