"""Reports: what is claimed to be zero is zero, what is held out is held out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.reference import left_out
from helpers.small_library import NAMES, measured, small_library, spectral_files
from matplotlib.transforms import Bbox

from manifold.brdf.plausibility import plausibility
from manifold.colour.difference import colour_differences, multi_angle_pairs
from manifold.core import pairs
from manifold.core.metrics import cube_root_error, relative_error, rmse
from manifold.core.pairs import RusinkiewiczGrid, cosine_weight
from manifold.evaluate import method_data, report
from manifold.evaluate.cross_validation import encode_all
from manifold.evaluate.method_data import Data
from manifold.evaluate.methods import standard_methods
from manifold.evaluate.model_methods import model_methods, replaced_keys
from manifold.evaluate.report_text import format_report, format_summary, lead
from manifold.gp.encoding import encoding_pairs
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.decoding import appearance_pairs
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialCache, MaterialTable
from manifold.model.settings import BlendSettings, GplvmSettings
from manifold.pictures import figures, map_figure

KINDS = ("gplvm",)


@pytest.fixture(scope="module", autouse=True)
def small_grid(short_search):
    """The default grid with a tenth of its pairs: what holds for these holds for all."""
    made_of_it = (appearance_pairs, encoding_pairs)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(pairs.NAMED_GRIDS, "default", RusinkiewiczGrid(20, 11, 6))
        for made in made_of_it:
            made.cache_clear()
        yield
    for made in made_of_it:
        made.cache_clear()  # other modules have the whole grid again


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    library = Library.open(small_library(tmp_path_factory.mktemp("report")))
    return {kind: Manifold.fit(library, GplvmSettings(), calibrate=False) for kind in KINDS}


@pytest.fixture(scope="module")
def reports(models):
    return {kind: report.make_report(model, compare=True) for kind, model in models.items()}


@pytest.fixture(scope="module")
def model(models):
    return models["gplvm"]


@pytest.fixture(scope="module")
def made(reports):
    return reports["gplvm"]


@pytest.fixture(scope="module")
def data(model):
    return Data.evaluate(model.materials.filled(), RusinkiewiczGrid.named("default"))


def method(made, key):
    return next(m for m in made.methods if m.key == key)


def method_of(model, key):
    return next(m for m in model_methods(model) if m.key == key)


@pytest.mark.parametrize("kind", KINDS)
def test_reconstruction_is_exactly_zero(reports, kind):
    reconstruction = method(reports[kind], "reconstruction")
    assert not np.any(reconstruction.errors.rmse)
    assert not np.any(list(reconstruction.errors.colours.values()))
    assert not reconstruction.is_held_out


@pytest.mark.parametrize("kind", KINDS)
def test_the_smooth_reconstruction_is_off_by_little(reports, kind):
    """What the delta adds at a latent is small: mu of the variance."""
    smooth, kept = (method(reports[kind], key).median.linear for key in ("smooth", "gp_latents_kept"))
    assert 0.0 < smooth < 0.5 * kept


def test_a_data_frame_has_the_errors_of_every_method_and_material(made):
    frame = made.to_pandas()
    assert len(frame) == len(made.methods) * len(made.names)
    for m in made.methods:
        rows = frame[frame["method"] == m.key].set_index("material")
        np.testing.assert_array_equal(rows.loc[list(made.names), "ball"], m.errors.ball)


@pytest.mark.parametrize("kind", KINDS)
def test_held_out_methods_never_use_the_material_itself(models, data, kind):
    for m in model_methods(models[kind]):
        if m.is_held_out:
            for i in (0, data.n_materials - 1):
                combination = left_out(m, data, i)
                weights = combination.weights.reshape(*combination.weights.shape[:-1], data.n_materials, -1)
                assert np.all(weights[..., i, :] == 0.0)
                np.testing.assert_allclose(combination.weights.sum(axis=-1), 1.0, atol=1e-9)


def test_latents_kept_are_the_closed_form_of_leave_one_out(models, data):
    """Rasmussen & Williams 2006, eq. 5.12, for weights and variances."""
    model = models["gplvm"]
    combinations = encode_all(data, method_of(model, "gp_latents_kept")).combinations
    found = np.array([c.weights for c in combinations])
    np.testing.assert_allclose(found, model.gp.leave_one_out_weights(), atol=1e-8)
    ratio = np.array([c.variance for c in combinations]) / model.gp.leave_one_out_variance()
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_knowing_more_helps(reports, kind):
    errors = {m.key: m.errors.linear for m in reports[kind].methods}
    assert np.all(errors["oracle"] <= errors["linear"] + 1e-9)
    assert np.all(errors["linear"] <= errors["nearest"] + 1e-9)
    assert np.median(errors["gp_refitted"]) < np.median(errors["nearest"])


@pytest.mark.parametrize("key", ["gp_latents_kept", "oracle", "pca_6_cube_root"])
def test_errors_agree_with_a_direct_computation(model, data, made, key):
    """Slow and obvious: all values of all materials, all pairs at once."""
    wi, wo, above = RusinkiewiczGrid.named("default").directions()
    n_pairs, wi, wo = len(wi), wi[above], wo[above]
    w = cosine_weight(wi, wo)
    f = np.stack([m.eval(wi, wo) for m in model.materials.filled()])
    methods = [*model_methods(model), *standard_methods()]
    chosen = next(m for m in methods if m.key == key)
    result = method(made, key)
    negative = 0
    for i in range(len(f)):
        c = left_out(chosen, data, i)
        T = c.mapping.forward(f, w[:, None])
        if c.sample_bands is None:
            mapped = np.tensordot(c.weights, T, axes=1)
        else:
            mapped = np.einsum("bns,nps->pb", c.weights.reshape(3, len(f), 3), T)
        predicted = c.mapping.inverse(mapped, w[:, None])
        negative += np.count_nonzero(predicted < 0)
        if c.is_clipped:
            predicted = np.maximum(predicted, 0.0)
        assert result.errors.linear[i] == pytest.approx(relative_error(f[i], predicted, w), rel=1e-7)
        assert result.errors.rmse[i] == pytest.approx(rmse(f[i], predicted, n_pairs=n_pairs), rel=1e-7)
    share = negative / f.size
    assert (result.negative_share, result.clipped_share) == (share, share if c.is_clipped else 0.0)


def test_colours_and_plausibility_are_those_of_the_prediction(models, reports):
    """The reconstruction of the nearest material is a measured BRDF: it can be asked directly."""
    model, result = models["gplvm"], method(reports["gplvm"], "nearest")
    materials = model.materials.filled()
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    nearest = [c.source for c in encode_all(data, standard_methods()[0]).combinations]
    wi, wo = multi_angle_pairs()
    physical = [plausibility(materials[n]) for n in nearest]
    assert result.max_albedo == pytest.approx(max(p.max_albedo for p in physical), rel=1e-9)
    assert result.reciprocity_error == pytest.approx(max(p.reciprocity_error for p in physical), rel=1e-9)
    for i, n in enumerate(nearest):
        delta_e, angle = colour_differences(
            materials[i].eval(wi, wo), materials[n].eval(wi, wo), model.bands, "D65"
        )
        assert result.errors.colours["D65"][i] == pytest.approx(delta_e.mean(), rel=1e-9)
        assert result.errors.angles_deg["D65"][i] == pytest.approx(angle.mean(), rel=1e-9)


def test_three_errors_stand_side_by_side(models, reports):
    """Of the nearest material, which is a measured BRDF: all three can be had directly."""
    model, result = models["gplvm"], method(reports["gplvm"], "nearest")
    materials = model.materials.filled()
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default"))
    nearest = [c.source for c in encode_all(data, standard_methods()[0]).combinations]
    balls = MaterialTable(materials, data.bands)
    for i, n in enumerate(nearest):
        assert result.errors.linear[i] == pytest.approx(relative_error(data.f[i], data.f[n], data.cosines))
        assert result.errors.cube_root[i] == pytest.approx(
            cube_root_error(data.f[i], data.f[n], data.cosines)
        )
        assert result.errors.ball[i] == pytest.approx(balls.look(i, balls.on_ball.f[n]).ball)
        assert set(balls.look(i, balls.on_ball.f[i]).lights.values()) == {0.0}
        assert (
            0.5 < result.errors.ball_itp[i] / result.errors.ball[i] < 20.0
        )  # another unit, of the same pictures
    for name in ("linear", "cube_root", "ball", "ball_itp", "worst"):
        errors = getattr(result.errors, name)
        assert getattr(result.median, name) == np.median(errors)
        assert getattr(result.p90, name) == np.percentile(errors, 90)


def test_other_grids_are_walked_in_blocks(models, monkeypatch):
    """The published grid, made coarser for the test: the same weights, other pairs, errors as if evaluated at once."""
    grid = RusinkiewiczGrid(9, 9, 18, squared_theta_h=False, offset=0.0)
    monkeypatch.setitem(pairs.NAMED_GRIDS, "hikichi", grid)
    monkeypatch.setattr(method_data, "_BLOCK_VALUES", 2000)
    model = models["gplvm"]
    made = report.make_report(model, "hikichi")
    wi, wo, above = grid.directions()
    f = np.stack([m.eval(wi[above], wo[above]) for m in model.materials.filled()])
    data = Data.evaluate(model.materials.filled(), RusinkiewiczGrid.named("default"))
    linear = next(m for m in standard_methods() if m.key == "linear")
    for i in range(len(f)):
        predicted = np.tensordot(left_out(linear, data, i).weights, f, axes=1)
        expected = rmse(f[i], predicted, n_pairs=grid.n_pairs)
        assert method(made, "linear").errors.rmse[i] == pytest.approx(expected, rel=1e-9)


def test_eq_22_is_that_of_all_bands_within_the_error_that_is_printed(tmp_path):
    for name, file in list(spectral_files().items())[:3]:
        write_bsdf(tmp_path / f"{name}_spec.bsdf", file)
    import_files(tmp_path / "library.zarr", sorted(tmp_path.glob("*.bsdf")))
    settings = GplvmSettings(mapping="identity")
    model = Manifold.fit(tmp_path / "library.zarr", settings, calibrate=False)
    some, every = (report.make_report(model, all_bands=all_bands) for all_bands in (False, True))
    assert (some.n_error_bands, every.n_error_bands, every.n_bands) == (23, 60, 60)
    grid, materials = RusinkiewiczGrid.named("default"), model.materials.filled()
    wi, wo, above = grid.directions()
    f = [material.eval(wi[above], wo[above]) for material in materials]
    data = Data.evaluate(materials, grid)
    for i, found in enumerate(method(every, "nearest").errors.rmse):
        nearest = left_out(standard_methods()[0], data, i).source
        expected = reference.rmse(f[i], f[nearest]) * np.sqrt(above.sum() / grid.n_pairs)
        assert found == pytest.approx(expected, rel=1e-5)  # weighted sums are in single precision
    for estimate, exact in zip(some.methods, every.methods, strict=True):
        assert exact.rmse_uncertainty == 0.0
        for name in ("rmse", "rmse_80"):
            a, b = getattr(estimate.median, name), getattr(exact.median, name)
            assert abs(a - b) <= estimate.rmse_uncertainty * b
            assert a == pytest.approx(b, rel=0.01)  # these spectra are linear between three bands
    assert "estimated from 23 of 60 bands, with an error of up to about" in format_report(some)
    assert "estimated from" not in format_report(every)


def test_standardised_errors_are_given_where_a_method_has_a_variance(made):
    for m in made.methods:
        has_variance = m.is_held_out and (m.key.startswith(("gp", "published")))
        assert (m.rms_standardised_error is not None) == has_variance
        if m.standardised_error is not None:
            rms = np.sqrt(np.mean(np.square(m.standardised_error)))
            assert m.rms_standardised_error == pytest.approx(rms)


def test_the_size_of_a_method_counts_files_and_stored_numbers(model, made):
    files = sum(model.library.attributes(name).bytes for name in model.names)
    assert method(made, "nearest").bytes == files + 8 * len(model.names)
    assert method(made, "pca_6_identity").bytes == files + 6 * 8 * len(model.names)


def test_long_methods_are_left_out_unless_asked_for(models):
    long = {m.key for m in standard_methods() if report.is_long(m, 51, 195)}
    assert long == {
        "published", "gplvm_2", "gplvm_6", "blend_2", "blend_3", "nonnegative", "few_atoms",
    }  # fmt: skip
    assert not any(report.is_long(m, 20, 3) for m in standard_methods())
    assert report.is_long(method_of(models["gplvm"], "gp_refitted"), 51, 195)


def test_no_method_is_listed_twice(models, reports):
    assert replaced_keys(models["gplvm"]) == {"pca_2_log_relative"}  # gplvm_2 is by another optimizer
    for made in reports.values():
        keys = [m.key for m in made.methods]
        assert len(set(keys)) == len(keys)


def test_a_map_of_blends_is_refitted_and_has_no_process(models):
    """It finds places in one way: rows of a Gaussian process on its coordinates would say nothing of it."""
    blend = Manifold.fit(models["gplvm"].library, BlendSettings(), calibrate=False)
    assert [m.key for m in model_methods(blend)] == [
        "reconstruction", "blend_encoded", "blend_refitted", "pca_log_relative",
    ]  # fmt: skip
    assert replaced_keys(blend) == {"blend_2", "pca_2_log_relative"}


def test_a_report_leads_with_the_models_own_error_for_left_out_materials(models, monkeypatch):
    """Also where refits take too long: then with that of a calibration, which finds the same places."""
    monkeypatch.setattr(report, "LONGEST_REFITS", 0.0)
    blend = Manifold.fit(models["gplvm"].library, BlendSettings())
    made = report.make_report(blend)
    own, nearest = method(made, "blend_encoded"), method(made, "nearest")
    assert "blend_refitted" not in {m.key for m in made.methods}
    assert own.is_held_out
    np.testing.assert_allclose(
        own.errors.ball, blend.left_out.errors.ball, rtol=0.05, atol=0.05
    )  # of fewer bands
    sentences = lead(made).split(". ")
    assert len(sentences) == 5
    own_map = made.coherence["this model"]
    assert f"the detour is {own_map.detour:.2f} in the median" in sentences[4]
    assert f"{own.median.ball:.1f} CIEDE2000" in sentences[1]
    assert f"{nearest.median.ball:.1f}" in sentences[2]
    text = format_report(made)
    assert text.index("Each material was left out") < text.index("at its own latent")


def test_a_summary_has_the_errors_of_left_out_materials_by_their_balls_first(made):
    text = format_summary(made)
    tables = [block for block in text.split("\n\n") if "\n---" in block]
    errors = tables[0].splitlines()
    assert errors[0].split()[:3] == ["method", "CIEDE2000", "p90"]
    held_out = [m for m in made.methods if m.is_held_out]
    assert len(errors) == 2 + len(held_out) < 2 + len(made.methods)
    for m in held_out:
        (row,) = (line for line in errors if line.startswith(f"{m.title}  "))
        assert row.removeprefix(m.title).split()[0] == f"{m.median.ball:.2f}"
    assert len(tables) == 1 + (made.expected_errors is not None)
    assert "expected errors" in text.lower()
    assert max(map(len, text.splitlines())) <= 80


def test_legends_are_printed_only_for_methods_that_have_a_row(models, reports, monkeypatch):
    monkeypatch.setattr(report, "LONGEST_REFITS", 0.0)
    blend = Manifold.fit(models["gplvm"].library, BlendSettings(), calibrate=False)
    of_gplvm, of_blend = format_report(reports["gplvm"]), format_report(report.make_report(blend))
    of_a_process = ("Kernel: ", "condition of K", "others' latents kept: ", "without delta: ")
    for words in (*of_a_process, "Q + 2 per band: ", "few samples and lobes: "):
        assert words in of_gplvm  # which a comparison with other models has
        assert words not in of_blend
    titles = [line.split("  ")[0] for line in of_blend.splitlines()]
    assert titles.index("PCA 6, identity") - titles.index("PCA 2, log-relative") == 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_report_names_synthetic_materials_and_every_method(reports, kind):
    made = reports[kind]
    text = format_report(made)
    assert "synthetic" in text.splitlines()[0]
    assert not [line for line in text.splitlines() if len(line) > 80]  # columns of a terminal
    for m in made.methods:
        assert m.title in text
    for name in made.names:
        assert name in text


@pytest.mark.parametrize("kind", KINDS)
def test_every_material_is_shown_with_its_left_out_errors(reports, kind):
    made = reports[kind]
    text = format_report(made)
    first = method(made, "gp_refitted")
    for k, name in enumerate(made.names):
        (row,) = (line.split() for line in text.splitlines() if line.startswith(f"{name} "))
        assert {f"{first.errors.ball[k]:.2f}", f"{first.errors.linear[k]:.3f}"} <= set(row)


def test_methods_without_errors_of_their_own_have_no_table_of_them(made):
    assert "rms z" in format_report(made)
    unknown = [replace(m, rms_standardised_error=None) for m in made.methods]
    text = format_report(replace(made, methods=tuple(unknown)))
    assert "rms z" not in text


def test_errors_of_a_black_material_are_powers_of_ten(made):
    """Anything over nothing is a very large number, of 300 digits if written out."""
    black = [
        replace(m, errors=replace(m.errors, linear=np.full(len(made.names), 1e300))) for m in made.methods
    ]
    text = format_report(replace(made, methods=tuple(black)))
    assert "1e+300" in text


def test_the_report_is_plain_json(made):
    document = json.loads(json.dumps(made.to_json(), allow_nan=False))
    assert document["names"] == list(made.names)
    assert document["program"].startswith("manifold ")
    assert {m["key"] for m in document["methods"]} >= {"reconstruction", "gp_refitted", "linear", "nearest"}


def test_the_map_shows_every_material_where_it_lies(model, tmp_path):
    marked = model.between("syn_felt_green", "syn_satin_gold", 0.5)
    figure = map_figure.latent_map(model, marked=marked)
    axes = figure.axes[0]
    labels = {text.get_text() for text in axes.texts}
    assert labels == {n.removeprefix("syn_").replace("_", " ") for n in model.names} | {"predicted"}
    dots = [np.asarray(c.get_offsets()) for c in axes.collections]
    assert any(d.shape == model.X.shape and np.allclose(d, model.X) for d in dots)
    assert any(d.shape == (1, 2) and np.allclose(d[0], marked) for d in dots)
    assert "synthetic" in axes.get_title()
    figures.save(figure, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_a_felt_dot_has_the_colour_of_the_felt(model):
    colours = map_figure.material_colours(model, model.landmarks)
    red, green, blue = colours[model.names.index("syn_felt_green")]
    assert green > red
    assert green > blue


def test_names_on_the_map_do_not_cover_each_other(model):
    figure = map_figure.latent_map(model)
    renderer = figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer) for text in figure.axes[0].texts]
    common = [Bbox.intersection(a, b) for k, a in enumerate(boxes) for b in boxes[:k]]
    covered = sum(box.width * box.height for box in common if box is not None)
    assert covered < 0.05 * sum(box.width * box.height for box in boxes)


@pytest.mark.parametrize("suffix", [".xyz", ""])
def test_unknown_picture_formats_are_refused(model, tmp_path, suffix):
    from manifold.core.errors import UsageError

    with pytest.raises(UsageError, match="picture format"):
        figures.save(map_figure.latent_map(model), tmp_path / f"map{suffix}")


def test_blends_are_judged_by_the_files_with_their_negative_values(tmp_path):
    """Colours outside sRGB have some; blends combine materials without them."""
    for name in NAMES[:4]:
        file = measured(name)
        write_bsdf(tmp_path / f"{name}_rgb.bsdf", replace(file, spectra=file.spectra - np.float32(0.02)))
    import_files(tmp_path / "library.zarr", [tmp_path])
    library = Library.open(tmp_path / "library.zarr")
    made = report.make_report(Manifold.fit(library, BlendSettings(), calibrate=False))
    filled = MaterialCache(library, library.names).filled()
    data = Data.evaluate(filled, RusinkiewiczGrid.named("default"))
    assert data.f.min() < 0.0
    errors = [data.relative_error(0, other) for other in data.f[1:]]
    found = method(made, "nearest").errors.linear[0]
    assert min(abs(found - error) for error in errors) < 1e-12
