"""The chart of settings on a small library."""

import numpy as np
import pytest
import small_library

from manifold.brdf import MeasuredBRDF
from manifold.chart import make_chart
from manifold.chart_settings import SEED, settings
from manifold.errors import UsageError
from manifold.metrics import RusinkiewiczGrid

MATERIALS = [MeasuredBRDF(small_library.measured(name)) for name in small_library.NAMES]


@pytest.fixture(scope="module")
def chart():
    return make_chart(MATERIALS, grid=RusinkiewiczGrid(18, 9, 6)).to_json()


def test_every_setting_has_finite_measures(chart):
    assert len(chart["charted"]) == len({s.key for s in settings()}) >= 25
    for row in chart["charted"]:
        numbers = [row[k] for k in ("relative_error", "rmse", "fit_ratio", "predict_ratio", "bytes")]
        assert np.isfinite(numbers).all(), row["key"]
        assert min(numbers) > 0, row["key"]


def test_the_seed_keeps_far_more_bytes_than_its_files_and_is_on_no_front_of_bytes(chart):
    rows = {row["key"]: row for row in chart["charted"]}
    assert rows[SEED]["bytes"] > 10 * rows["gplvm_2_identity"]["bytes"]
    assert "bytes" not in rows[SEED]["on_front"]


def test_halves_keep_half_of_the_measured_bytes_at_nearly_the_same_error(chart):
    rows = {row["key"]: row for row in chart["charted"]}
    whole, half = rows["pca_6_cube-root"], rows["pca_6_cube-root_half"]
    assert 0.49 < half["bytes"] / whole["bytes"] < 0.52
    assert half["relative_error"] == pytest.approx(whole["relative_error"], rel=0.01)  # float16 keeps 11 bits


def test_an_unknown_setting_is_one_clear_error():
    with pytest.raises(UsageError, match="no setting is called 'pca'"):
        make_chart(MATERIALS, ["pca"])
