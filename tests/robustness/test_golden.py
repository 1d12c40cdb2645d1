"""What the comparison of numbers with those that were kept says, and what is kept of results."""

from __future__ import annotations

import numpy as np
from golden import comparison
from golden.values import flat


def lines(old, new):
    return "\n".join(comparison.compared("report", {"numbers": old}, {"numbers": new}))


def test_a_number_that_moved_is_named_with_its_change():
    said = lines({"ball": 1.0, "cube root": 0.2}, {"ball": 1.1, "cube root": 0.2})
    assert "moved 1 of 2" in said
    assert "ball: 1 -> 1.1 (9.1e-02)" in said


def test_rounding_is_no_move():
    assert not lines({"ball": 1.0, "nothing": 0.0}, {"ball": 1.0 + 1e-9, "nothing": 1e-12})


def test_renamed_numbers_are_compared(monkeypatch):
    old, new = {"m/delta_e": 1.0}, {"m/ball": 2.0}
    assert "disappeared 1, appeared 1; 0 of them" in lines(old, new)
    assert "1 of them with an equal value" in lines(old, {"m/ball": 1.0})
    monkeypatch.setattr(comparison, "RENAMED", ((r"^(report: .*)delta_e$", r"\1ball"),))
    assert "m/ball: 1 -> 2" in lines(old, new)


def test_a_new_failure_is_said_and_an_old_one_is_not():
    old, failed = {"numbers": {}}, {"failed": "no such option"}
    assert comparison.compared("x", old, failed) == ["failed: no such option"]
    assert comparison.compared("x", failed, failed) == []


def test_values_of_an_array_that_change_places_are_a_move():
    x = np.linspace(0.0, 1.0, 50)
    old, new = flat({"x": x}), flat({"x": x[::-1]})
    assert lines(old, new).count("->") == 1
    assert "x/in order" in lines(old, new)


def test_times_paths_dates_and_versions_are_no_numbers():
    kept = flat(
        {
            "fit_seconds": 1.0,
            "program": "manifold 1.0",
            "note": "manifold 0.2.0 read /tmp/a/b.bsdf on 2026-01-02",
        }
    )
    assert kept == {"note": " read b.bsdf on "}
