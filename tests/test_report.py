"""Reports: what is claimed to be zero is zero, what is held out is held out."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_library import small_library

from manifold import plot, report
from manifold.mapping import mapping_named
from manifold.metrics import cosine_weight, relative_error, rusinkiewicz_grid
from manifold.model import Manifold
from manifold.report_text import format_report
from manifold.store import Library


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return Manifold.fit(Library.open(small_library(tmp_path_factory.mktemp("report"))))


@pytest.fixture(scope="module")
def made(model):
    return report.make_report(model)


def method(made, key):
    return next(m for m in made.methods if m.key == key)


def test_reconstruction_is_exactly_zero(made):
    reconstruction = method(made, "reconstruction")
    assert reconstruction.rmse == (0.0,) * len(made.names)
    assert not reconstruction.is_held_out


def test_held_out_methods_never_use_the_material_itself(model):
    for m in report._methods(model):
        if m.is_held_out:
            np.testing.assert_array_equal(np.diag(m.weights), 0.0)
        np.testing.assert_allclose(m.weights.sum(axis=1), 1.0, atol=1e-9)


def test_a_refitted_prediction_is_closer_than_the_mean_of_the_others(model):
    weights = report._refitted_weights(model)
    others = np.delete(np.arange(len(model.names)), 0)
    S = model.S[np.ix_(others, others)]
    assert weights[0, 0] == 0.0
    # Distance of the prediction from the left-out material in the mapped domain: no worse than the mean's.
    v = weights[0, others]
    c = model.S[0, others]
    mean = np.full(len(others), 1.0 / len(others))

    def squared(w):
        return model.S[0, 0] - 2.0 * w @ c + w @ S @ w

    assert squared(v) < squared(mean)


def test_nearest_material_has_the_smallest_distance(model):
    weights = report._nearest_weights(model.S)
    distance = np.diag(model.S)[:, None] + np.diag(model.S)[None, :] - 2.0 * model.S
    for i, row in enumerate(weights):
        others = np.delete(np.arange(len(row)), i)
        assert row.argmax() == others[distance[i, others].argmin()]


def test_errors_agree_with_a_direct_computation(model, made):
    wi, wo, above = rusinkiewicz_grid()
    wi, wo = wi[above], wo[above]
    f = np.stack([m.eval(wi, wo) for m in model.load_materials()])
    weights = model.gp.leave_one_out_weights()
    T = mapping_named("cube-root")
    predicted = T.inverse(np.tensordot(weights, T.forward(f), axes=1))
    for i, found in enumerate(method(made, "gp_latents_kept").relative_error):
        assert found == pytest.approx(relative_error(f[i], predicted[i], cosine_weight(wi, wo)), rel=1e-9)


def test_the_report_names_synthetic_materials_and_every_method(made):
    text = format_report(made)
    assert "synthetic" in text.splitlines()[0]
    for m in made.methods:
        assert m.title in text
    for name in made.names:
        assert name in text


def test_the_report_is_plain_json(made):
    document = json.loads(json.dumps(made.to_json(), allow_nan=False))
    assert document["names"] == list(made.names)
    assert document["program"].startswith("manifold ")
    assert {m["key"] for m in document["methods"]} >= {"reconstruction", "gp_refitted", "linear", "nearest"}


def test_the_map_shows_every_material_where_it_lies(model, tmp_path):
    marked = model.between("syn_felt_green", "syn_satin_gold", 0.5)
    figure = plot.latent_map(model, marked=marked)
    axes = figure.axes[0]
    labels = {text.get_text() for text in axes.texts}
    assert labels == {n.removeprefix("syn_").replace("_", " ") for n in model.names} | {"predicted"}
    dots = axes.collections[0].get_offsets()
    np.testing.assert_allclose(dots, model.X)
    np.testing.assert_allclose(axes.collections[1].get_offsets()[0], marked)
    assert "synthetic" in axes.get_title()
    plot.save(figure, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_a_felt_dot_has_the_colour_of_the_felt(model):
    colours = plot._material_colours(model)
    red, green, blue = colours[model.names.index("syn_felt_green")]
    assert green > red
    assert green > blue


def test_names_on_the_map_do_not_cover_each_other(model):
    figure = plot.latent_map(model)
    renderer = figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer).extents for text in figure.axes[0].texts]
    area = sum((b[2] - b[0]) * (b[3] - b[1]) for b in boxes)
    covered = sum(plot._overlap(a, b) for k, a in enumerate(boxes) for b in boxes[:k])
    assert covered < 0.05 * area


@pytest.mark.parametrize("suffix", [".xyz", ""])
def test_unknown_picture_formats_are_refused(model, tmp_path, suffix):
    from manifold.errors import UsageError

    with pytest.raises(UsageError, match="picture format"):
        plot.save(plot.latent_map(model), tmp_path / f"map{suffix}")
