"""All main steps from end to end, and its results in Mitsuba."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.mitsuba_reference import measured
from helpers.quick_fits import fit_quickly
from helpers.quick_pictures import draw_quickly
from helpers.real_materials import real_materials
from helpers.small_library import small_model

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.cli import demo as demo_module
from manifold.cli.main import app
from manifold.core import shipped
from manifold.core.directions import from_spherical
from manifold.estimate.predictions import predict
from manifold.evaluate import make_report
from manifold.evaluate.methods import chart_methods
from manifold.evaluate.report_text import lead
from manifold.evaluate.seen_fits import METHODS
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.colours import ColourChoice
from manifold.model.comparison import brdf_errors
from manifold.model.embedding import embed
from manifold.model.expected_error import coherence_of
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialTable
from manifold.model.settings import BlendSettings
from manifold.pictures import fit_comparison as comparison
from manifold.pictures import slice_figures
from manifold.render.images import read_image
from manifold.render.render import RenderSettings
from manifold.study.budget import budgets, example_scenes
from manifold.study.stability.catalogue import MODES

FEW = {"syn_satin_gold", "syn_metallic_gold", "syn_paper_white", "syn_felt_yellow"}
CHARTED_AND_TRIED = demo_module.CHARTED, demo_module.TRIED  # tests below have less
SCENE = {"felt": example_scenes.EXAMPLES["felt"]}


@pytest.fixture(scope="module")
def few_materials():
    """A few materials of the corpus in 15 bands, and the demo cut down to the least of every step: it takes seconds."""
    few, measure = tuple(m for m in corpus.isotropic_materials() if m.name in FEW), corpus.measure

    def in_few_bands(material, **how):
        file = measure(material, **how)
        if file.wavelengths_nm is None:
            return file
        return replace(file, wavelengths_nm=file.wavelengths_nm[6::13], spectra=file.spectra[:, :, 6::13])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(corpus, "isotropic_materials", lambda: few)
        patch.setattr(corpus, "measure", in_few_bands)
        patch.setattr(example_scenes, "EXAMPLES", SCENE)
        patch.setattr(demo_module, "EXAMPLES", SCENE)
        patch.setattr(budgets, "BudgetSettings", partial(budgets.BudgetSettings, size=32, samples=16))
        patch.setattr(demo_module.maps, "walk", partial(demo_module.maps.walk, steps=2))
        patch.setattr(demo_module, "CHARTED", ("nearest", demo_module.CHARTED[2], "pca_2_cube-root"))
        patch.setattr(demo_module, "TRIED", ("sharp_lobe",))
        little = partial(RenderSettings, size=32, samples=16)
        patch.setattr(demo_module, "RenderSettings", little)
        patch.setattr(comparison, "picture_of_fit", partial(comparison.picture_of_fit, settings=little()))
        draw_quickly(patch)
        fit_quickly(patch)
        yield few


@pytest.fixture(scope="module")
def announced(tmp_path_factory, few_materials):
    """All results of a demo, and those whose files were there when they were announced."""
    present = []

    def look(made):
        if all(path.exists() and path.stat().st_size > 0 for path in made.paths):
            present.append(made)

    return demo_module.run(tmp_path_factory.mktemp("demo"), everything=True, announce=look), present


@pytest.fixture(scope="module")
def demo(announced):
    return announced[0]


@pytest.fixture(scope="module")
def folder(demo):
    return demo.made[-1].paths[0].parent


def test_what_the_demo_charts_and_tries_is_in_the_registries():
    charted, tried = CHARTED_AND_TRIED
    known = {setting.key for setting in chart_methods(195)} | {f"fit_{method}" for method in METHODS}
    assert set(charted) <= known
    assert set(tried) <= {mode.key for mode in MODES}


@pytest.mark.slow
def test_the_demo_runs_all_its_steps_on_materials_of_every_scene(tmp_path, monkeypatch):
    names = FEW | {scene.material for scene in example_scenes.EXAMPLES.values()}
    some = tuple(m for m in corpus.isotropic_materials() if m.name in names)
    monkeypatch.setattr(corpus, "isotropic_materials", lambda: some)
    made = demo_module.run(tmp_path, everything=True)
    assert all(path.stat().st_size > 0 for path in made.pictures)
    assert len(made.pictures) == 14
    assert made.left_out is None


def directions(rng, n):
    theta, phi = rng.uniform(0, np.deg2rad(75), (2, n)), rng.uniform(-np.pi, np.pi, (2, n))
    w = from_spherical(theta, phi).astype(np.float32).astype(np.float64)
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


def test_every_result_of_the_demo_exists_when_it_is_announced(announced):
    result, present = announced
    assert tuple(present) == result.made


def test_the_demo_renders_its_prediction_under_two_illuminants(demo, folder):
    daylight, lamp = (read_image(folder / f"predicted_{name}.png") for name in demo_module.ILLUMINANTS)
    assert np.abs(daylight - lamp).mean() > 0.002  # a coloured material differs under a fluorescent lamp


def test_the_report_of_the_demo_is_of_its_library(folder):
    assert Library.open(folder / "library.zarr").names == tuple(sorted(FEW))
    assert json.loads((folder / "report.json").read_text())["names"] == sorted(FEW)
    assert "synthetic" in (folder / "report.txt").read_text()


def test_the_demo_ends_in_a_page_whose_links_are_there(demo, folder):
    index = folder / "index.html"
    text = index.read_text()
    links = set(re.findall(r'(?:href|src)="([^"]*)"', text))
    assert links >= {"explorer.html", "library.zarr", *(path.name for path in demo.pictures)}
    for link in links:
        assert (index.parent / link).exists(), link
    assert lead(demo.report) in html.unescape(text)
    commands = html.unescape(text.split("<pre>")[1].split("</pre>")[0]).splitlines()
    assert commands[0] == f"cd {index.parent}"
    for command in commands[1:]:
        program, name, *_ = command.split()
        assert Path(program).exists()
        assert name in {each.name for each in app.registered_commands}


def test_the_page_of_the_demo_begins_with_a_measured_material_and_its_errors(demo, folder):
    text = html.unescape((folder / "index.html").read_text())
    made = demo.completed
    assert text.index(made.words) < text.index("completed.png") < text.index(lead(demo.report))
    assert f"off by {made.true:.1f} CIEDE2000" in made.words
    name, library = made.name, Library(shipped.BUILT_IN)
    measured = MeasuredBRDF(library.read(name))
    assert made.true == brdf_errors(measured, MeasuredBRDF(read_bsdf(made.path))).ball
    # The file samples the values that the calibration judges.
    assert made.true == pytest.approx(made.left_out[library.names.index(name)], rel=0.05)
    assert made.true < 2.0 * made.expected


def test_halfway_between_the_pair_that_the_demo_shows_is_between_them():
    """The built-in map is tested, at each angle of the slices and in the ball."""
    model = Manifold.load(shipped.BUILT_IN)
    materials = model.materials.filled()
    _, pairs = coherence_of(
        model.space, MaterialTable(materials, np.arange(model.bands.count)), model.mapping
    )
    pair = demo_module.pair_to_show(model, pairs)
    assert (pair.second, pair.first) in {(other.first, other.second) for other in pairs}
    made = model.predict(0.5 * (model.X[pair.first] + model.X[pair.second]))
    ends = [materials[k] for k in (pair.first, pair.second)]
    for incidence in np.deg2rad(slice_figures.INCIDENCES_DEG):
        wo = from_spherical(np.deg2rad(np.linspace(-85.0, 85.0, 341)), 0.0)
        wi = np.broadcast_to(from_spherical(incidence, np.pi), wo.shape)
        values, predicted = np.stack([each.eval(wi, wo) for each in ends]), made.eval(wi, wo)
        assert np.all(
            predicted >= 0.94 * values.min(axis=0)
        )  # the others' weights are at most 2 % of cube roots
        assert np.all(predicted <= 1.06 * values.max(axis=0))
    differences = [brdf_errors(end, made).ball for end in ends]
    assert max(differences) < pair.difference
    assert sum(differences) < 1.1 * pair.difference


def test_a_predicted_file_opens_in_mitsuba_and_is_the_prediction(demo, folder, rng):
    model = Manifold.load(folder / "model.h5")
    brdf = model.predict(np.array(demo.predicted.latent))
    file = read_bsdf(demo.predicted.path)
    wi, wo = directions(rng, 1500)
    bands = rng.integers(0, len(file.wavelengths_nm), (1500, 4))
    f_cos, _ = measured(demo.predicted.path, wi, wo, file.wavelengths_nm[bands].astype(float))
    expected = np.take_along_axis(brdf.eval_cos(wi, wo), bands, axis=1)
    error = np.abs(f_cos - expected) / np.abs(expected).mean()
    # 32 x 32 nodes and 8 elevations through noisy interpolants: 1 to 13 % by gloss.
    assert np.median(error) < 0.03
    assert error.mean() < 0.05


def test_the_predicted_file_says_what_it_is(demo):
    file = read_bsdf(demo.predicted.path)
    assert file.name == "predicted"
    assert file.description.startswith("Predicted at latent (")
    assert "synthetic" in file.description
    assert file.spectra.min() >= 0.0


def test_running_the_demo_again_keeps_what_is_there(demo, folder, monkeypatch):
    class Stopped(Exception):
        pass

    def stop(*_, **__):
        raise Stopped

    monkeypatch.setattr(corpus, "measure", lambda *_, **__: pytest.fail("measured again"))
    monkeypatch.setattr(demo_module, "complete_measured", lambda _: demo.completed)
    monkeypatch.setattr(demo_module, "make_report", stop)  # all that follows the map is made anew
    before = Manifold.load(folder / "model.h5")
    with pytest.raises(Stopped):
        demo_module.run(folder)
    np.testing.assert_array_equal(
        Manifold.load(folder / "model.h5").latent("syn_satin_gold"), before.latent("syn_satin_gold")
    )


def test_a_place_on_the_path_between_two_materials_is_written(tmp_path):
    model, wi = Manifold.load(small_model(tmp_path)), from_spherical(0.5, 0.0)
    place = "syn_satin_gold:syn_gloss_red:0.3"
    made = predict(model, place, tmp_path / "between_rgb.bsdf")
    assert made.walk == "between syn_satin_gold and syn_gloss_red, t = 0.3"
    assert read_bsdf(made.path).origin == "predicted"
    assert made.weights == []  # those at its latent are of other materials
    expected = model.interpolate("syn_satin_gold", "syn_gloss_red", 0.3).albedo(wi)
    np.testing.assert_array_equal(model.predict(place).albedo(wi), expected)
    written = MeasuredBRDF(read_bsdf(made.path)).albedo(wi)
    np.testing.assert_allclose(written, expected, rtol=0.03)  # of 8 incidences
    latent = model.place(place).latent
    assert not np.allclose(model.predict(latent).albedo(wi), expected, rtol=0.1)
    chosen = predict(model, place, tmp_path / "green_rgb.bsdf", colour=ColourChoice(srgb="#208020"))
    same = predict(model, latent, tmp_path / "same_rgb.bsdf", colour=ColourChoice(srgb="#208020"))
    assert chosen.weights == same.weights


@pytest.mark.parametrize("share", [5, pytest.param(1, marks=pytest.mark.slow)], ids=["every fifth", "all"])
def test_the_main_job_runs_on_real_files(tmp_path, share):
    files = [tmp_path / f"{file.name}_rgb.bsdf" for file in real_materials()[::share]]
    for path, file in zip(files, real_materials()[::share], strict=True):
        write_bsdf(path, file)
    library, model = tmp_path / "library.zarr", tmp_path / "model.h5"
    result = import_files(library, files)
    assert not result.failed
    embed(library, model, BlendSettings())
    fitted = Manifold.load(model)
    assert len(fitted.names) == len(result.imported)
    suffix = "rgb" if fitted.bands.is_rgb else "spec"
    made = predict(model, [-0.1, 0.2], tmp_path / f"between_{suffix}.bsdf")
    assert np.all(np.isfinite(read_bsdf(made.path).spectra))
    report = make_report(model, picture=tmp_path / "map.png")
    assert not report.methods[0].errors.rmse.any()
    assert not any(report.is_synthetic)
    if share > 1:
        return  # too few to learn from
    refitted = next(m for m in report.methods if m.key == "blend_refitted")
    nearest = next(m for m in report.methods if m.key == "nearest")
    assert refitted.median.linear < nearest.median.linear


def test_a_unit_does_not_merge_different_samples(run, tmp_path):
    table = (
        "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,R,G,B\n45,180,0,0,0.3,0.2,0.1\n45,180,30,0,0.3,0.2,0.1\n"
    )
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(table)
    for given in (("a.csv", "b.csv"), (".",)):
        status, _, err = run("complete", *given, "--unit", "factor", cwd=tmp_path)
        assert status == 2
        assert "--unit works only with one file of readings" in err
