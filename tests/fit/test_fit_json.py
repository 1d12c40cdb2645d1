"""Fits as files: the schema, what comes back, the workflow and the command."""

from __future__ import annotations

import copy
import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_library import measured, small_model
from typer.testing import CliRunner

from manifold.analytic.base import Lambert
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.cli.main import app
from manifold.core import work
from manifold.core.errors import FileFormatError
from manifold.core.records import Bands
from manifold.estimate.inputs import find_inputs
from manifold.estimate.sources import FileSource
from manifold.fit import fits
from manifold.fit.fit_samples import FitSamples, from_brdf
from manifold.fit.fits import FitSettings
from manifold.fit.principled import fit_bsdf
from manifold.io_rgl import write_bsdf
from manifold.many.batch import batch
from manifold.render import backend, fit_json
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import diffuse, principled
from manifold.render.fitted_brdf import FittedBRDF

SETTINGS = FitSettings(principled(["base_color", "roughness", "metallic"]))


@pytest.fixture(scope="module")
def satin(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("files") / "satin_rgb.bsdf"
    write_bsdf(path, measured("syn_satin_gold"))
    return path


@pytest.fixture(scope="module")
def fitted(satin, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fits") / "satin.fit.json"
    fits.fit(satin, path, SETTINGS)
    return path


def evaluate(bsdf, wi, wo):
    """f_cos (M, 3) of a Mitsuba BSDF."""
    mi, dr = backend.mitsuba(colour="rgb"), backend.drjit()
    if mi.variant().startswith("llvm"):
        si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
        si.wi = mi.Vector3f(wi.T.astype(np.float32))
        return np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)), True)).T
    si, rows = mi.SurfaceInteraction3f(), []
    for a, b in zip(wi, wo, strict=True):
        si.wi = mi.Vector3f(*a)
        rows.append(np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*b), True)))
    return np.array(rows)


@pytest.mark.parametrize("kind", ["../evil", "evil", "plugins/evil"])
def test_a_fit_that_names_another_library_is_refused(fitted, tmp_path, monkeypatch, kind):
    """Mitsuba would load the native code in `plugins/TYPE.so`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plugins").mkdir()
    for path in (tmp_path / "evil.so", tmp_path / "plugins" / "evil.so"):
        path.write_text("no library")
    text = fitted.read_text(encoding="utf-8").replace('"principled"', json.dumps(kind))
    (tmp_path / "evil.fit.json").write_text(text, encoding="utf-8")
    for use in (fit_json.read, fit_json.read_bsdf):
        with pytest.raises(FileFormatError, match=r"type .*(plain name|neither a plugin)"):
            use(tmp_path / "evil.fit.json")
    family = {"type": kind, "parameters": [{"name": "a", "minimum": 0.0, "maximum": 1.0, "default": 0.5}]}
    (tmp_path / "family.json").write_text(json.dumps(family), encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"type .*(plain name|neither a plugin)"):
        fits.read_family(tmp_path / "family.json")


def test_a_second_run_keeps_a_fit_unless_file_settings_or_program_changed(satin, fitted, tmp_path):
    target = tmp_path / "satin.fit.json"

    def kept(settings=SETTINGS, **changes):
        content = json.loads(fitted.read_text(encoding="utf-8")) | changes
        target.write_text(json.dumps(content), encoding="utf-8")
        return fits.fit(satin, target, settings).was_there

    assert kept()
    assert not kept(FitSettings(SETTINGS.family, metric="log"))
    assert not kept(program="manifold 0.0.1")
    assert not kept(seconds=1e9)  # changed by hand
    assert fit_json.read(target)["values"] == fit_json.read(fitted)["values"]


def test_the_json_recreates_the_fitted_bsdf(satin, fitted):
    samples = from_brdf(MeasuredBRDF(measured("syn_satin_gold")))
    whole = evaluator(SETTINGS.family, samples.wi, samples.wo, 3)
    expected = whole.values(whole.layout.join(fit_json.read(fitted)["values"]))[0]
    direct = fit_bsdf(measured("syn_satin_gold"), SETTINGS.family)
    assert direct.values == fit_json.read(fitted)["values"]  # a fit is determined by its samples
    for bsdf in (
        fit_json.read_bsdf(fitted),
        backend.mitsuba(colour="rgb").load_dict(fit_json.read(fitted)["mitsuba"]),
    ):
        found = evaluate(bsdf, samples.wi, samples.wo)
        assert np.max(np.abs(found - expected)) <= 1e-5 * np.max(expected)  # Mitsuba: single precision


def test_a_spectral_fit_loads_in_a_spectral_variant():
    bands = Bands((420.0, 500.0, 580.0, 660.0))
    rng = np.random.default_rng(0)
    pairs = rng.normal(size=(2, 60, 3))
    pairs[..., 2] = np.abs(pairs[..., 2]) + 0.2
    pairs /= np.linalg.norm(pairs, axis=-1, keepdims=True)
    f = np.tile([0.05, 0.1, 0.2, 0.3], (60, 1))
    result = fit_bsdf(
        FitSamples.from_arrays(pairs[0], pairs[1], f, bands=bands), principled(["base_color", "roughness"])
    )
    content = fits.document(result, fit_json.FitSource("flat"))
    mi = backend.mitsuba(colour="spectral")
    try:
        assert isinstance(mi.load_dict(content["mitsuba_spectral"]), mi.BSDF)
    finally:
        backend.mitsuba(colour="rgb")
    assert content["spectra"]["wavelengths_nm"] == list(bands.wavelengths_nm)


def test_the_json_names_its_source_and_how_it_was_made(satin, fitted):
    content = json.loads(fitted.read_text())
    assert content["source"]["sha256"] == hashlib.sha256(satin.read_bytes()).hexdigest()
    assert content["source"]["file"] == satin.name
    assert content["hyperparameters"]["noise"] == SETTINGS.noise
    assert content["minima"][0]["values"] == content["values"]
    # the latter three are what earlier fits lack
    assert {*fit_json.schema()["required"], "errors", "rotation_deg", "sha256"} == set(content)
    assert not list(fitted.parent.glob(".*"))


def test_a_white_standard_becomes_diffuse_and_is_kept_by_the_next_run(tmp_path):
    path = tmp_path / "white.bsdf"
    write_bsdf(path, goniometer.measure(Lambert(np.full(3, 0.9), Bands(None)), "white", resolution=32))
    target = tmp_path / "white.fit.json"
    made = fits.fit(path, target, FitSettings())
    assert made.content is not None
    assert made.content["mitsuba"]["type"] == "diffuse"
    assert fits.fit(path, target, FitSettings()).was_there
    wi = np.array([[0.0, 0.6, 0.8]])
    assert FittedBRDF.read(target).eval(wi, wi) == pytest.approx(0.9 / np.pi, rel=0.01)


def test_a_prediction_names_its_model_and_latent(tmp_path):
    model = small_model(tmp_path)
    target = tmp_path / "between.fit.json"
    made = fits.fit(fits.PlaceSource(model, [0.1, -0.2]), target, SETTINGS)
    source = fit_json.read(target)["source"]
    assert source["latent"] == [0.1, -0.2]
    assert source["model_sha256"] == hashlib.sha256(model.read_bytes()).hexdigest()
    assert made.content is not None
    assert made.content["residuals"]["cube-root"] < made.content["diffuse_residual"]


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)], ids=["here", "in processes"])
def test_one_bad_file_among_several_stops_nothing(tmp_path, count):
    folder = tmp_path / "files"
    folder.mkdir()
    for name in ("syn_satin_gold", "syn_felt_green"):
        write_bsdf(folder / f"{name}_rgb.bsdf", measured(name))
    (folder / "broken.bsdf").write_bytes(b"not a tensor file")
    with work.processes(count) as workers:
        command, inputs = fits.fits(SETTINGS), find_inputs([FileSource(folder)])
        outcomes = batch(command, inputs, tmp_path / "fits", workers).outcomes
    assert [o.name for o in outcomes] == ["broken", "syn_felt_green", "syn_satin_gold"]
    assert [o.failure is None for o in outcomes] == [False, True, True]
    assert sorted(p.name for p in (tmp_path / "fits").glob("*.fit.json")) == [
        "syn_felt_green.fit.json", "syn_satin_gold.fit.json",
    ]  # fmt: skip


def test_a_black_file_an_unusable_name_and_a_name_taken_fail_alone(satin, tmp_path):
    folder = tmp_path / "files"
    (folder / "other").mkdir(parents=True)
    black = measured("syn_felt_green")
    write_bsdf(folder / "black_rgb.bsdf", replace(black, spectra=np.zeros_like(black.spectra)))
    for name in ("_rgb.bsdf", "red\n\x1b[31m_rgb.bsdf", "satin_rgb.bsdf", "other/satin_rgb.bsdf"):
        shutil.copy(satin, folder / name)
    words = ["fit", str(folder), "-o", str(tmp_path / "fits"), "--free", "base_color", "-j", "1"]
    result = CliRunner().invoke(app, [*words, "--json", str(tmp_path / "all.json")])
    assert [path.name for path in (tmp_path / "fits").glob("*.fit.json")] == ["satin.fit.json"]
    failed = json.loads((tmp_path / "all.json").read_text())["failed"]
    assert len(failed) == 4
    for words in ("'' cannot be the name", "cannot be the name", "nothing to fit", "have the same name"):
        assert any(words in line for line in failed)
    assert all(line.isprintable() for line in failed)
    assert str(result.exception).isprintable()


def test_the_command_fits_and_says_what_it_knows(satin, tmp_path):
    target = tmp_path / "out.json"
    arguments = ["fit", str(satin), "-o", str(target), "--free", "base_color,roughness", "--json", "-"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["fits"][0] == json.loads(target.read_text())
    shown = CliRunner().invoke(app, arguments[:-2])
    assert "roughness" in shown.stdout
    assert "up to date" in shown.stdout


def test_a_described_bsdf_is_fitted_by_the_command(satin, tmp_path):
    family = {
        "type": "roughplastic",
        "parameters": [
            {"name": "diffuse_reflectance", "minimum": 0, "maximum": 1, "default": 0.5, "per_band": True},
            {"name": "alpha", "minimum": 0.02, "maximum": 1, "default": 0.3, "transform": "log"},
        ],
        "fixed": {"distribution": "ggx"},
    }
    description, target = tmp_path / "family.json", tmp_path / "out.json"
    description.write_text(json.dumps(family))
    result = CliRunner().invoke(app, ["fit", str(satin), "-o", str(target), "--bsdf", str(description)])
    assert result.exit_code == 0, result.output
    assert fit_json.read(target)["mitsuba"]["type"] == "roughplastic"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.pop("values"), "'values'"),
        (lambda c: c.update(format="other"), "format"),
        (lambda c: c.update(format_version=2), "format_version is 2, expected 1"),
        (lambda c: c.update(n_pairs="many"), 'n_pairs is "many", expected integer'),
        (lambda c: c.update(seconds=10**400), "seconds is 1000.*, expected number"),
        (lambda c: c["source"].pop("sha256"), "'sha256'"),
        (lambda c: c.update(values={}), "values has nothing"),
        (lambda c: c["values"].update(roughness="rough"), 'values.roughness is "rough"'),
        (
            lambda c: c["values"].update(roughness=-0.5),
            "values.roughness is -0.5, expected a number from 0.02",
        ),
        (
            lambda c: c["values"].update(base_color=[0.1, 0.2]),
            r"values.base_color is \[0.1, 0.2\], expected 3",
        ),
        (lambda c: c["values"].update(roughness=0.123), "mitsuba and the values differ in roughness"),
        (
            lambda c: c.update(mitsuba_spectral={"type": "x"}),
            "mitsuba_spectral and the values differ in type",
        ),
        (lambda c: c.update(residuals={}), "residuals has no 'cube-root'"),
        (lambda c: c.update(diffuse_residual=float("nan")), "NaN is not a valid number in JSON"),
        (lambda c: c["bsdf"]["parameters"][0].update(minimum=2.0), "minimum < maximum"),
    ],
)
def test_a_changed_document_is_refused_by_name(fitted, tmp_path, change, words):
    content = copy.deepcopy(json.loads(fitted.read_text()))
    change(content)
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=words) as raised:
        fit_json.read(path)
    assert "\n" not in str(raised.value)


def test_spectral_values_must_agree_with_what_is_rendered():
    bands = Bands((450.0, 550.0, 650.0))
    wi = wo = np.array([[0.0, np.sin(t), np.cos(t)] for t in np.linspace(0.0, 1.2, 12)])
    samples = FitSamples.from_arrays(wi, wo, np.tile([0.05, 0.1, 0.2], (12, 1)), bands=bands)
    made = fits.document(fit_bsdf(samples, diffuse()), fit_json.FitSource("flat"))
    made = json.loads(json.dumps(made))
    fit_json.require_fit(made, "x.json")
    for change, words in (
        (
            lambda c: c["spectra"]["values"].update(reflectance=[0.1, 0.2]),
            "expected 3 numbers from 0 to 1;",
        ),
        (lambda c: c["spectra"]["values"].update(reflectance=[0.1, 0.2, -0.1]), "expected 3 numbers from 0"),
        (lambda c: c["spectra"]["values"].update(reflectance=[0.1, 0.2, 0.3]), "differ in reflectance"),
        (lambda c: c["spectra"].update(wavelengths_nm=[500.0, 450.0, 600.0]), "do not increase"),
        (lambda c: c["spectra"].update(values={}), "spectra.values has nothing"),
        (lambda c: c.update(spectra=None), "mitsuba_spectral and the values differ"),
    ):
        content = copy.deepcopy(made)
        change(content)
        with pytest.raises(FileFormatError, match=words):
            fit_json.require_fit(content, "x.json")


@pytest.mark.parametrize("text", ["[" * 100_000, "1" * 5000, '"\\x"', "", "\xff"])
def test_what_is_no_json_is_one_clear_error_and_no_fit_to_keep(satin, tmp_path, text):
    path = tmp_path / "bad.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileFormatError, match=r"bad\.json") as raised:
        fit_json.read(path)
    assert "\n" not in str(raised.value)
    with pytest.raises(FileFormatError, match=r"bad\.json"):
        fits.read_family(path)
    plain = FitSettings(principled(["base_color"]))
    assert fits.fit(satin, path, plain).failure is None
    assert fit_json.read(path)["source"]["name"] == "satin"


PLAIN = {"name": "reflectance", "minimum": 0, "maximum": 1, "default": 0.5}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            {"type": "diffuse", "parameters": [PLAIN | {"minimum": False}]},
            "minimum is false, expected number",
        ),
        ({"type": "diffuse", "parameters": [PLAIN | {"maximum": 10**400}]}, "expected number"),
        ({"type": "diffuse", "parameters": [PLAIN | {"minimum": 2}]}, "minimum < maximum"),
        ({"type": "diffuse", "parameters": [PLAIN | {"per_band": "no"}]}, 'per_band is "no"'),
        ({"type": "diffuse", "parameters": [PLAIN | {"name": "a\nb"}]}, "name"),
        ({"type": "diffuse", "parameters": [PLAIN | {"colour": 1}]}, "colour"),
        ({"type": "diffuse"}, "has no 'parameters'"),
        (
            {"type": "diffuse", "parameters": [PLAIN], "fixed": {"a": {"type": "rgb", "value": None}}},
            "contains null",
        ),
        ([], "expected object"),
    ],
)
def test_a_wrong_description_of_a_bsdf_is_one_clear_error_that_names_the_file(tmp_path, content, words):
    path = tmp_path / "family.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=words) as raised:
        fits.read_family(path)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)
