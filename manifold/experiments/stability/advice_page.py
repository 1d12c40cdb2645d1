"""Results of the catalogue of failure modes, as a table and as a page with advice."""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Sequence

from manifold.experiments.stability.trials import FINE, OUTCOMES, WRONG, Mode, Row, Stability
from manifold.model.settings import KINDS
from manifold.system.names import counted

COLUMNS = ("failure mode", "method", "undetected", "limit", "outcome")
_MODE_WIDTH, _METHOD_WIDTH = 21, 15
FALSE_ALARM = "false alarm"


def table(made: Stability) -> list[list[str]]:
    """A row per mode and method: the largest error without a message, its limit, and what happened.

    A mode is named in its first row only.
    """
    rows, previous = [], None
    for row in made.rows:
        rows.append(
            [
                short(row.mode, _MODE_WIDTH) if row.mode != previous else "",
                short(row.method, _METHOD_WIDTH),
                _number(row.undetected_error),
                f"{row.limit:g}",
                outcomes(row),
            ]
        )
        previous = row.mode
    return rows


def outcomes(row: Row) -> str:
    """Outcomes in order of severity, each once (*fine, warned*), or the defect where there is one."""
    if row.is_wrong:
        return WRONG
    if row.is_false_alarm:
        return FALSE_ALARM
    return ", ".join(dict.fromkeys(one.outcome for one in row.results))


def conclusion(made: Stability) -> str:
    """What to conclude, and which kind of map to choose where several were tried in the same modes."""
    said = (
        "Results without a message can be trusted in these modes: every error above its limit was announced."
    )
    if made.wrong:
        wrong = ", ".join(f"{row.method} ({row.mode})" for row in made.wrong)
        said = f"Wrong without a message, so check these by other means: {wrong}."
    tried = {kind: {row.mode: row for row in made.rows if row.method == kind} for kind in KINDS}
    kinds = [kind for kind, rows in tried.items() if rows]
    shared = set.intersection(*(set(tried[kind]) for kind in kinds)) if kinds[1:] else set()
    if shared:
        fine = {
            kind: sum(one.outcome == FINE for mode in shared for one in tried[kind][mode].results)
            for kind in kinds
        }
        if len({*fine.values()}) == 1:
            return f"{said} All kinds of map are fine equally often: choose by accuracy."
        best = max(kinds, key=lambda kind: fine[kind])
        others = ", ".join(f"{kind} {fine[kind]}" for kind in kinds if kind != best)
        trials = sum(len(tried[best][mode].results) for mode in shared)
        said += (
            f" Kind of map to choose: {best}, fine in {fine[best]} of {counted(trials, 'trial')} ({others})."
        )
    return said


def summary(made: Stability) -> str:
    """The number of trials of each outcome, in one line."""
    trials = [one.outcome for row in made.rows for one in row.results]
    modes = len({row.mode for row in made.rows})
    counts = ", ".join(f"{trials.count(outcome)} {outcome}" for outcome in OUTCOMES)
    return (
        f"{counted(modes, 'failure mode')}, {len(trials)} trials: {counts}; "
        f"{len(made.false_alarms)} false alarms in {len(made.rows)} rows, {made.early_warnings} early warnings"
    )


def markdown(made: Stability, modes: Sequence[Mode], picture: str | None = None) -> str:
    """A page: what every mode is, what happened, and what a user should do; the link of its picture, if it has one."""
    tried = {row.mode for row in made.rows}
    parts = [
        "# Failure modes, and what to do",
        "",
        "Written by `manifold stability --markdown`; do not edit.",
        "",
        "Every failure mode is applied with increasing severity. A trial is *fine* if its error stays below the "
        "limit, *warned* if the package issued a warning or a diagnostic, *refused* if it ended with an error "
        "message, and *silently wrong* if the error exceeds the limit without any of these. The first severity "
        "is harmless: a warning or a refusal there is a *false alarm*. False alarms and silently wrong results "
        "are defects and fail the tests. A warning at a later severity although the error is below the limit is "
        "an *early warning*. *Undetected* is the largest error without a warning or an error message.",
        "",
        *(() if picture is None else (f"![Error against severity of every failure mode]({picture})", "")),
        conclusion(made),
        "",
        summary(made) + ".",
        "",
    ]
    for what, reason in made.skipped.items():
        parts += [f"{what} was skipped: {_cell(reason)}.", ""]
    for mode in modes:
        if mode.key in tried:
            parts += _chapter(mode, [row for row in made.rows if row.mode == mode.key])
    return "\n".join(parts)


def _chapter(mode: Mode, rows: Sequence[Row]) -> list[str]:
    lines = [
        f"## {mode.key}",
        "",
        f"{_sentence(mode.concerns)} Severity: {mode.severity} ({', '.join(f'{s:g}' for s in mode.severities)}).",
        "",
        f"Error: {mode.limit.quantity}; limit {mode.limit.value:g}: {_cell(mode.limit.reason)}.",
        "",
        f"**What to do.** {_sentence(mode.advice)}",
        "",
        "| method | undetected | outcomes | first message |",
        "|---|---|---|---|",
    ]
    for row in rows:
        message = next((one.message for one in row.results if one.message), "")
        lines.append(
            f"| {row.method} | {_number(row.undetected_error)} | {_by_severity(row)} | {_cell(message)} |"
        )
    return [*lines, ""]


def _by_severity(row: Row) -> str:
    """Outcomes with the severity that each begins at: *fine; warned from 0.1*."""
    first = row.results[0].outcome
    parts = [f"{first} ({FALSE_ALARM})" if row.is_false_alarm else first]
    for before, one in itertools.pairwise(row.results):
        if before.outcome != one.outcome:
            parts.append(f"{one.outcome} from {one.severity:g}")
    return "; ".join(parts)


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _cell(text: str) -> str:
    """A message in a table, without the temporary folders that it names."""
    folder = re.escape(tempfile.gettempdir()) + r"/[^/\s]+/"
    return re.sub(folder, "", " ".join(text.split())).replace("|", "\\|")


def short(text: str, width: int) -> str:
    """A text cut to a width."""
    return text if len(text) <= width else text[: width - 2] + ".."


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"
