"""Trials of failure modes: how they are judged, and how that is shown."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from helpers.paths import REPOSITORY

from manifold.core.errors import RendererError, UsageError
from manifold.study.stability import catalogue, stability_figure
from manifold.study.stability.catalogue import MODES
from manifold.study.stability.testbed import TestBed
from manifold.study.stability.trials import (
    FINE,
    REFUSED,
    WARNED,
    WRONG,
    Limit,
    Measurement,
    Mode,
    Row,
    Stability,
    TrialResult,
    run_modes,
    select_modes,
)

Found = Measurement | list[Measurement] | Exception


def mode_of(*found: Found, limit: float = 1.0) -> Mode:
    """A mode with these results, by severity."""

    def trial(bed: TestBed, severity: float) -> Measurement | list[Measurement]:
        result = found[int(severity)]
        if isinstance(result, Exception):
            raise result
        return result

    severities = tuple(float(k) for k in range(len(found)))
    why = Limit("number", limit, "a reason")
    return Mode("made_up", "a thing", "step", severities, why, {"it": trial}, "Do this.")


def test_outcomes_follow_from_what_happened():
    mode = mode_of(
        Measurement(0.5),
        Measurement(2.0, ("beware",)),
        UsageError("no such thing; use another"),
        Measurement(2.0),
        Measurement(float("nan")),
        ValueError("oops"),
    )
    (row,) = run_modes([mode]).rows
    assert [one.outcome for one in row.results] == [FINE, WARNED, REFUSED, WRONG, WRONG, WRONG]
    assert [one.message for one in row.results] == [
        "", "beware", "no such thing; use another", "", "", "ValueError: oops"
    ]  # fmt: skip


def test_a_method_that_this_machine_cannot_run_is_skipped_and_named():
    made = run_modes([mode_of(RendererError("it needs LLVM; use another")), mode_of(Measurement(0.5))])
    assert made.skipped == {"made_up: it": "it needs LLVM; use another"}
    assert [row.is_false_alarm for row in made.rows] == [False]
    assert made.to_json(MODES)["skipped"] == made.skipped


def test_of_several_results_each_is_judged_by_what_was_said_about_it():
    warned, silent = Measurement(9.0, ("beware",)), Measurement(0.5)
    (row,) = run_modes([mode_of([warned, silent], [warned, Measurement(2.0)], [warned, warned])]).rows
    assert [one.outcome for one in row.results] == [WARNED, WRONG, WARNED]
    assert [one.error for one in row.results] == [9.0, 9.0, 9.0]
    assert [one.undetected_error for one in row.results] == [0.5, 2.0, None]


def test_a_row_is_as_wrong_as_its_worst_undetected_error():
    mode = mode_of(Measurement(0.2), Measurement(9.0, ("beware",)), UsageError("no"))
    (row,) = run_modes([mode]).rows
    assert row.undetected_error == 0.2
    assert not row.is_wrong
    assert not row.is_false_alarm
    assert catalogue.outcomes(row) == "fine, warned, refused"


@pytest.mark.parametrize("first", [Measurement(0.1, ("beware",)), UsageError("no")])
def test_a_warning_or_a_refusal_at_the_harmless_end_is_a_false_alarm(first):
    made = run_modes([mode_of(first, Measurement(9.0, ("beware",)))])
    assert len(made.false_alarms) == 1
    assert made.wrong == ()
    assert catalogue.outcomes(made.rows[0]) == "false alarm"
    assert "1 false alarms in 1 rows" in catalogue.summary(made)
    assert made.to_json([])["false_alarms"] == 1


def test_warnings_of_errors_within_the_limit_are_counted_as_early():
    rows = run_modes([mode_of(Measurement(0.1), Measurement(0.9, ("so",)), Measurement(1.1, ("so",)))])
    assert rows.early_warnings == 1


def test_unknown_names_are_answered_with_those_known():
    with pytest.raises(UsageError, match=r"did you mean duplicates, near_duplicates\?"):
        select_modes(MODES, ["duplicate"])
    assert [mode.key for mode in select_modes(MODES, ["outlier", "duplicates"])] == ["duplicates", "outlier"]


def test_keys_are_unique_and_every_mode_has_methods_severities_reasons_and_advice():
    assert len({mode.key for mode in MODES}) == len(MODES)
    for mode in MODES:
        assert mode.methods
        assert len(mode.severities) >= 2
        assert mode.limit.reason
        assert mode.advice.endswith(".")


# -- what is shown ------------------------------------------------------------------------------------------


@pytest.fixture
def wrong_mode(monkeypatch) -> Mode:
    """A catalogue of one mode that is silently wrong at its end."""
    mode = mode_of(Measurement(0.5), Measurement(2.0, ("beware | of this",)), Measurement(3.0))
    monkeypatch.setattr("manifold.study.stability.catalogue.MODES", (mode,))
    return mode


def test_the_command_ends_with_status_1_where_a_row_is_silently_wrong(wrong_mode, tmp_path, capsys):
    from manifold.cli.main import run

    (tmp_path / "images").mkdir()
    files = {"--json": "s.json", "-o": "images/s.png"}
    with pytest.raises(SystemExit) as left:
        run(
            [
                "stability",
                *(part for option, name in files.items() for part in (option, str(tmp_path / name))),
            ]
        )
    assert left.value.code == 1
    assert "silently wrong" in capsys.readouterr().out
    written = json.loads((tmp_path / "s.json").read_text())
    assert [one["outcome"] for one in written["rows"][0]["results"]] == [FINE, WARNED, WRONG]
    assert written["modes"][0]["advice"] == "Do this."
    assert (tmp_path / "images/s.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_known_to_be_wrong_is_said_and_ends_with_status_0(monkeypatch, capsys):
    from manifold.cli.main import run

    mode = replace(mode_of(Measurement(0.5), Measurement(3.0)), known=("it",))
    monkeypatch.setattr("manifold.study.stability.catalogue.MODES", (mode,))
    with pytest.raises(SystemExit) as left:
        run(["stability"])
    assert left.value.code == 0
    assert "known: it is wrong without a message in made_up" in capsys.readouterr().out


def all_fine() -> Stability:
    """Every mode and method, fine throughout."""
    return Stability(
        tuple(
            Row(
                mode.key,
                method,
                mode.limit.value,
                tuple(TrialResult(s, 1.234e-5, 1.234e-5, FINE) for s in mode.severities),
            )
            for mode in MODES
            for method in mode.methods
        )
    )


def test_the_picture_has_a_panel_per_mode_and_a_line_per_method():
    figure = stability_figure.panels(all_fine(), MODES)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title().splitlines()[0] for axes in shown] == [mode.key for mode in MODES]
    for axes, mode in zip(shown, MODES, strict=True):
        assert [text.get_text() for text in axes.get_legend().get_texts()] == list(mode.methods)


def test_stability_says_what_to_trust_and_which_kind_of_map_to_choose():
    """Kinds are compared in the modes that all of them were tried in."""

    def row(mode, kind, *outcomes):
        return Row(mode, kind, 1.0, tuple(TrialResult(k, 0.5, 0.5, one) for k, one in enumerate(outcomes)))

    made = Stability(
        (
            row("a", "blend", FINE, WARNED),
            row("a", "gplvm", FINE, FINE),
            row("b", "blend", FINE, FINE, FINE),
        )
    )
    said = catalogue.conclusion(made)
    assert said.startswith("Results without a message can be trusted")
    assert "choose: gplvm, fine in 2 of 2 trials (blend 1)" in said
    assert catalogue.conclusion(Stability((row("a", "blend", FINE, WRONG),))) == (
        "Wrong without a message, so check these by other means: blend (a)."
    )
    assert "choose by accuracy" in catalogue.conclusion(all_fine())
    assert "can be trusted" in stability_figure.panels(all_fine(), MODES).get_suptitle()


def test_the_picture_counts_outcomes_and_false_alarms():
    mode = mode_of(Measurement(0.5, ("beware",)), Measurement(2.0))
    figure = stability_figure.panels(run_modes([mode]), [mode])
    (legend,) = figure.legends
    figure.draw_without_rendering()
    extent = legend.get_window_extent()
    assert figure.bbox.x0 <= extent.x0 < extent.x1 <= figure.bbox.x1  # one panel is narrow
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[:5] == ["fine (0)", "warned (1)", "refused (0)", "silently wrong (1)", "false alarm (1)"]


def test_the_results_in_the_documentation_are_of_every_mode():
    kept = json.loads((REPOSITORY / "benchmarks/results/stability.json").read_text())
    assert {one["key"]: one["advice"] for one in kept["modes"]} == {mode.key: mode.advice for mode in MODES}
    wrong = [row["mode"] for row in kept["rows"] if any(r["outcome"] == WRONG for r in row["results"])]
    assert not wrong
    assert kept["false_alarms"] == 0
