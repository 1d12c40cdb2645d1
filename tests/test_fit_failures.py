"""Fits that fail say so, and are silently wrong where the statement is taken away."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from manifold.experiments.stability import fit_failures
from manifold.experiments.stability.bench import Bench
from manifold.experiments.stability.trials import REFUSED, WARNED, WRONG, Mode, Tried, try_once
from manifold.fitting import fit_samples, principled
from manifold.rendering import backend

ROWS = [(mode.key, method) for mode in fit_failures.MODES for method in mode.methods]


def mode_named(key: str) -> Mode:
    return next(mode for mode in fit_failures.MODES if mode.key == key)


def tried(bench: Bench, key: str, method: str, severity: float | None = None) -> Tried:
    """One trial, by default the most severe."""
    mode = mode_named(key)
    severity = mode.severities[-1] if severity is None else severity
    return try_once(mode.methods[method], bench, severity, mode.threshold)


@cache
def tried_in_full(key: str, method: str) -> tuple[Tried, ...]:
    """A row, tried once."""
    with Bench() as bench:
        return tuple(tried(bench, key, method, severity) for severity in mode_named(key).severities)


@pytest.mark.parametrize(("key", "method"), ROWS)
def test_no_row_is_silently_wrong(key, method):
    if "adam" in method and not backend.mitsuba(colour="rgb").variant().startswith("llvm"):
        pytest.skip("adam needs LLVM")
    assert [one for one in tried_in_full(key, method) if one.outcome == WRONG] == []


def test_a_single_direction_is_refused():
    assert tried_in_full("few_directions", "one incidence")[-1].outcome == REFUSED


def test_a_swarm_is_silently_wrong_where_nobody_looks_for_a_step_down(monkeypatch):
    assert tried_in_full("local_minima", "swarm")[0].outcome == WARNED
    monkeypatch.setattr("manifold.fitting.identifiability.cost_after_a_step", lambda *arguments: float("inf"))
    with Bench() as bench:
        assert tried(bench, "local_minima", "swarm", 3.0).outcome == WRONG


def test_brushed_metal_is_not_called_diffuse_where_diffuse_fits_no_better():
    found = principled.fit_bsdf(fit_samples.from_brdf(fit_failures.brushed(10.0)))
    assert found.family.type == "principled"
    assert any("does not fit" in note for note in found.notes)


def test_smooth_grey_is_silently_wrong_where_rivals_are_not_told(monkeypatch):
    key, method = "rough_or_smooth", "gauss-newton, smooth grey"
    assert tried_in_full(key, method)[-1].outcome == WARNED
    made = principled._result

    def sure(*arguments, **known):
        found = made(*arguments, **known)
        sure = tuple(replace(s, state="determined") for s in found.statements)
        return replace(found, statements=sure, notes=(), minima=found.minima[:1])

    monkeypatch.setattr(principled, "_result", sure)
    with Bench() as bench:
        assert tried(bench, key, method).outcome == WRONG
