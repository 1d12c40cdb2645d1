"""The catalogue of failure modes: models are never silently wrong, and are where a guard is taken away."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from manifold import dls, gplvm, gpr
from manifold.errors import UsageError
from manifold.experiments.stability import (
    advice_page,
    extrapolation_failures,
    model_failures,
    search_failures,
    trials,
)
from manifold.experiments.stability.bench import Bench
from manifold.experiments.stability.catalogue import MODES
from manifold.experiments.stability.trials import (
    FINE,
    REFUSED,
    WARNED,
    WRONG,
    Found,
    Mode,
    Row,
    Stability,
    Tried,
    chosen,
    try_modes,
    try_once,
)
from manifold.model import diagnostics
from manifold.model.manifold import Manifold
from manifold.plots import plot_stability
from manifold.workflows import failures

OF_MODELS = (*model_failures.MODES, *extrapolation_failures.MODES, *search_failures.MODES)
PAGE = "docs/stability.md"


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with threadpool_limits(1, "blas"), Bench() as made:
        yield made


@pytest.fixture
def fresh_bench() -> Iterator[Bench]:
    """One that remembers nothing of what was said before a guard was taken away."""
    with threadpool_limits(1, "blas"), Bench() as made:
        yield made


def tried(bench: Bench, key: str, method: str, severity: float | None = None) -> Tried:
    """One trial, by default the most severe."""
    mode = next(mode for mode in MODES if mode.key == key)
    severity = mode.severities[-1] if severity is None else severity
    return try_once(mode.methods[method], bench, severity, mode.threshold)


@pytest.mark.parametrize(
    ("key", "method"), [(mode.key, method) for mode in OF_MODELS for method in mode.methods]
)
def test_models_are_never_silently_wrong(bench, key, method):
    mode = next(mode for mode in OF_MODELS if mode.key == key)
    # The command tries all severities; the worst two are where a guard is needed.
    found = [tried(bench, key, method, severity) for severity in mode.severities[-2:]]
    assert [one for one in found if one.outcome == WRONG] == []


# -- a guard taken away -------------------------------------------------------------------------------------


def test_without_the_flag_of_extrapolation_a_short_length_scale_is_silently_wrong(bench, monkeypatch):
    assert tried(bench, "short_length_scale", "material").outcome == WARNED
    monkeypatch.setattr(Manifold, "is_extrapolation", lambda *_: False)
    assert tried(bench, "short_length_scale", "material").outcome == WRONG


def test_without_a_word_about_jitter_an_ill_conditioned_kernel_is_silently_wrong(bench, monkeypatch):
    assert tried(bench, "ill_conditioned_kernel", "GP").outcome == WARNED
    monkeypatch.setattr(gpr, "warnings", SimpleNamespace(warn=lambda *_, **__: None))
    assert tried(bench, "ill_conditioned_kernel", "GP").outcome == WRONG


@pytest.mark.parametrize(
    ("key", "method", "severity"),
    [("long_length_scale", "monochrome", 1000.0), ("bad_starts", "l-bfgs", 100.0)],
)
def test_without_the_warning_of_fits_that_predict_little_they_are_silently_wrong(
    bench, monkeypatch, key, method, severity
):
    assert tried(bench, key, method, severity).outcome == WARNED
    monkeypatch.setattr(gpr.GPWeights, "warn_of_fit", lambda *_: None)
    assert tried(bench, key, method, severity).outcome == WRONG


def test_without_the_stopping_rule_a_search_cut_short_is_silently_wrong(bench, monkeypatch):
    assert tried(bench, "stopping_rule", "curved valley").outcome == WARNED
    monkeypatch.setattr(dls, "OUT_OF_EVALUATIONS", dls.CONVERGED)
    assert tried(bench, "stopping_rule", "curved valley").outcome == WRONG


def test_without_fresh_factorisations_the_objective_is_silently_wrong(bench, monkeypatch):
    assert tried(bench, "drift_of_updates", "dls").outcome == FINE
    monkeypatch.setattr(gplvm, "_DRIFT", np.inf)
    assert tried(bench, "drift_of_updates", "dls").outcome == WRONG


def test_without_the_diagnostic_an_impossible_reflectance_is_silently_wrong(bench, monkeypatch):
    monkeypatch.setattr(diagnostics, "MOST_MISSED", np.inf)
    monkeypatch.setattr(Manifold, "is_extrapolation", lambda *_: False)
    assert tried(bench, "impossible_reflectance", "monochrome").outcome == WRONG


def test_without_the_diagnostic_a_lobe_sharper_than_the_library_is_silently_wrong(bench, monkeypatch):
    monkeypatch.setattr(diagnostics, "MOST_EMBEDDING_ERROR", np.inf)
    assert tried(bench, "sharper_than_library", "material").outcome == WRONG


def test_without_diagnostics_of_plausibility_raw_values_are_silently_wrong_outside(fresh_bench, monkeypatch):
    for name in ("MOST_NEGATIVE", "MOST_ALBEDO", "MOST_NON_RECIPROCAL"):
        monkeypatch.setattr(diagnostics, name, np.inf)
    for key in ("negative_values", "energy_gain"):
        assert tried(fresh_bench, key, "raw values", 0.5).outcome == WRONG


# -- judging ------------------------------------------------------------------------------------------------


def mode_of(*found: Found | Exception, threshold: float = 1.0) -> Mode:
    """A mode that finds what it is told, by severity."""

    def trial(bench: Bench, severity: float) -> Found:
        result = found[int(severity)]
        if isinstance(result, Exception):
            raise result
        return result

    severities = tuple(float(k) for k in range(len(found)))
    return Mode("told", "a thing", "step", severities, "number", threshold, {"it": trial}, "Do this.")


def test_outcomes_follow_from_what_happened():
    mode = mode_of(
        Found(0.5),
        Found(2.0, ("beware",)),
        UsageError("no such thing; use another"),
        Found(2.0),
        Found(float("nan")),
        ValueError("oops"),
    )
    (row,) = try_modes([mode]).rows
    assert [one.outcome for one in row.tried] == [FINE, WARNED, REFUSED, WRONG, WRONG, WRONG]
    assert [one.said for one in row.tried] == [
        "", "beware", "no such thing; use another", "", "", "ValueError: oops"
    ]  # fmt: skip


def test_a_row_is_as_wrong_as_its_worst_unsaid_error():
    row = Row("m", "it", 1.0, (Tried(0, 0.2, FINE), Tried(1, 9.0, WARNED, "beware"), Tried(2, None, REFUSED)))
    assert row.unsaid_error == 0.2
    assert not row.is_wrong
    assert advice_page.outcomes(row) == "fine, warned, refused"


def test_unknown_names_are_answered_with_those_known():
    with pytest.raises(UsageError, match=r"expected one of .*duplicates"):
        chosen(MODES, ["dupes"])
    assert [mode.key for mode in chosen(MODES, ["outlier", "duplicates"])] == ["duplicates", "outlier"]


def test_keys_are_unique_and_every_mode_has_methods_severities_and_advice():
    assert len({mode.key for mode in MODES}) == len(MODES) >= 20
    for mode in MODES:
        assert mode.methods
        assert len(mode.severities) >= 2
        assert mode.advice.endswith(".")


# -- what is shown ------------------------------------------------------------------------------------------


@pytest.fixture
def told(monkeypatch) -> Mode:
    """A catalogue of one mode that is silently wrong at its end."""
    mode = mode_of(Found(0.5), Found(2.0, ("beware | of this",)), Found(3.0))
    monkeypatch.setattr(failures, "MODES", (mode,))
    return mode


def test_the_command_ends_with_status_1_where_a_row_is_silently_wrong(told, tmp_path, capsys, monkeypatch):
    from manifold.cli.main import run

    monkeypatch.setattr("manifold.experiments.stability.catalogue.MODES", (told,))
    files = {"--json": "s.json", "--markdown": "s.md", "--picture": "s.png"}
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
    assert [one["outcome"] for one in written["rows"][0]["tried"]] == [FINE, WARNED, WRONG]
    assert written["modes"][0]["advice"] == "Do this."
    assert (
        "fine; warned from 1; silently wrong from 2 | beware \\| of this |" in (tmp_path / "s.md").read_text()
    )
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")


def test_files_that_cannot_be_written_are_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(failures, "try_modes", lambda *_: pytest.fail("the work was done first"))
    for options in ({"picture": tmp_path / "no" / "s.png"}, {"page": tmp_path / "no" / "s.md"}):
        with pytest.raises(UsageError, match="cannot write"):
            failures.stability(**options)


def all_fine() -> Stability:
    """Every mode and method, fine throughout."""
    return Stability(
        tuple(
            Row(mode.key, method, mode.threshold, tuple(Tried(s, 1.234e-5, FINE) for s in mode.severities))
            for mode in MODES
            for method in mode.methods
        )
    )


def test_the_table_fits_eighty_columns():
    rows = advice_page.table(all_fine())
    widths = [max(map(len, column)) for column in zip(advice_page.COLUMNS, *rows, strict=True)]
    longest = max(len(", ".join((FINE, WARNED, REFUSED))), len(WRONG))
    assert sum(widths[:-1]) + longest + 2 * len(widths[:-1]) <= 80


def test_the_picture_has_a_panel_per_mode_and_a_line_per_method():
    figure = plot_stability.panels(all_fine(), MODES)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title().splitlines()[0] for axes in shown] == [mode.key for mode in MODES]
    for axes, mode in zip(shown, MODES, strict=True):
        assert [text.get_text() for text in axes.get_legend().get_texts()] == list(mode.methods)


def test_the_page_of_the_documentation_lists_every_mode_with_its_advice(request):
    text = (request.config.rootpath / PAGE).read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)$", text, flags=re.MULTILINE) == [mode.key for mode in MODES]
    for mode in MODES:
        assert f"**What to do.** {mode.advice}" in text
        chapter = text.split(f"## {mode.key}\n")[1].split("\n## ")[0]
        assert re.findall(r"^\| (?!method|-)([^|]+) \|", chapter, flags=re.MULTILINE) == list(mode.methods)
    assert trials.WRONG + " from" not in text
