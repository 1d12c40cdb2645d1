"""The catalogue of failure modes, the table of their results, and conclusions from it."""

from __future__ import annotations

from manifold.core.names import counted
from manifold.model.settings import KINDS
from manifold.study.stability import data_failures, fit_failures, model_failures
from manifold.study.stability.trials import FINE, OUTCOMES, WRONG, Mode, Row, Stability

MODES: tuple[Mode, ...] = (*model_failures.MODES, *data_failures.MODES, *fit_failures.MODES)

COLUMNS = ("failure mode", "method", "undetected", "limit", "outcome")
_MODE_WIDTH, _METHOD_WIDTH = 21, 15
FALSE_ALARM = "false alarm"


def table(made: Stability) -> list[list[str]]:
    """Return one row per mode and method: the largest error without a message, the limit, and the outcomes.

    A mode is named only in its first row.
    """
    rows, previous = [], None
    for row in made.rows:
        rows.append(
            [
                short(row.mode, _MODE_WIDTH) if row.mode != previous else "",
                short(row.method, _METHOD_WIDTH),
                "-" if row.undetected_error is None else f"{row.undetected_error:.2g}",
                f"{row.limit:g}",
                outcomes(row),
            ]
        )
        previous = row.mode
    return rows


def outcomes(row: Row) -> str:
    """Return the outcomes by rising severity, each once (*fine, warned*), or the defect if there is one."""
    if row.is_wrong:
        return WRONG
    if row.is_false_alarm:
        return FALSE_ALARM
    return ", ".join(dict.fromkeys(one.outcome for one in row.results))


def conclusion(made: Stability) -> str:
    """Return a conclusion as text; if several kinds of map were tried in the same modes, it names the better kind."""
    said = "Results without a message can be trusted in these modes: every error above its limit caused a message."
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
    """Return the number of trials of each outcome, in one line."""
    trials = [one.outcome for row in made.rows for one in row.results]
    modes = len({row.mode for row in made.rows})
    counts = ", ".join(f"{trials.count(outcome)} {outcome}" for outcome in OUTCOMES)
    return (
        f"{counted(modes, 'failure mode')}, {len(trials)} trials: {counts}; "
        f"{len(made.false_alarms)} false alarms in {len(made.rows)} rows, {made.early_warnings} early warnings"
    )


def short(text: str, width: int) -> str:
    """Cut a text to `width` characters."""
    return text if len(text) <= width else text[: width - 2] + ".."
