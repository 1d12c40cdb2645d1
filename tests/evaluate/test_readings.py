"""Errors of completion against the number of readings."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.readings import readings

from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.metrics import Errors
from manifold.estimate.expected import errors_of, leave_out
from manifold.evaluate.readings import Curve, measure_curves
from manifold.library.store import Library
from manifold.study.chart_figure import readings_chart


def test_curves_of_readings_are_those_of_completions(atoms):
    curves = measure_curves(atoms, (1, 6), ("completion", "nearest"))
    assert [curve.key for curve in curves] == ["completion", "nearest", "ma_t12", "ma_t12_gloss"]
    made = leave_out(atoms, 2, readings(np.ones((12, 3))))
    own = errors_of(atoms, 2, made.on_grid, made.on_ball)
    for name in ("ball", "cube_root", "linear"):
        assert getattr(curves[-2].errors[0], name)[2] == pytest.approx(getattr(own, name), rel=1e-9)
    assert [curve.counts for curve in curves[-2:]] == [(12,), (14,)]
    assert curves[-1].errors[0].median.cube_root < curves[-2].errors[0].median.cube_root
    with pytest.raises(UsageError, match="no method"):
        measure_curves(atoms, (1,), ("magic",))


def test_interrupted_curves_are_continued_and_finished_ones_measured_again(atoms, library, monkeypatch):
    measured: list[int] = []

    def measure(atoms, m, task, counts, methods):
        measured.append(m)
        return {method.key: np.full((len(counts), 3), float(m)) for method in methods}

    def interrupt(done: int, total: int, name: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    def curves(listener=None, only=("nearest",)):
        measured.clear()
        with progress.listen(listener):
            return measure_curves(atoms, (1, 6), only, Library.open(library))

    monkeypatch.setattr("manifold.evaluate.readings._errors_of", measure)
    everything = list(range(len(atoms.names)))

    with pytest.raises(KeyboardInterrupt):
        curves(interrupt)
    assert measured == [0, 1]
    curves(only=("completion",))
    assert measured == everything  # another chart shares nothing with it
    nearest = curves()[0]
    assert measured == everything[2:]
    np.testing.assert_array_equal(nearest.errors[1].linear, everything)
    curves()
    assert measured == everything


@pytest.mark.slow
def test_curves_of_fits_begin_where_readings_make_one_and_are_plain_json(atoms):
    fitted = measure_curves(atoms, (1, 6), ("principled",))[0]
    assert np.isnan(fitted.errors[0].ball).all()
    assert np.isfinite(fitted.errors[1].ball).all()
    json.dumps(fitted.to_json(), allow_nan=False)


def test_the_chart_of_readings_draws_every_curve():
    errors = Errors(*np.full((3, 3), 0.1))
    curves = [
        Curve(f"m{k}", f"method {k}", (2, 4)[:n], (errors,) * n) for k, n in enumerate((1, 2) * 4 + (1,))
    ]
    (legend,) = readings_chart(curves).legends
    assert [text.get_text() for text in legend.get_texts()] == [curve.title for curve in curves]
