"""`manifold fit --target`: the fit of an engine's own model as a file, and its export."""

from __future__ import annotations

import json

import pytest
from exported_files import gltf_parameters, read_glb
from instrument_files import zemax_file
from small_library import NAMES, measured, small_model
from typer.testing import CliRunner

from manifold.cli.main import app
from manifold.errors import FileFormatError, UsageError
from manifold.fitting import fit_json
from manifold.fitting.bsdf_parameters import principled
from manifold.fitting.exports import TARGETS
from manifold.fitting.exports.principled_values import Principled
from manifold.io_rgl import write_bsdf
from manifold.workflows import exports, fits
from manifold.workflows.fits import FitSettings


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A file `felt_rgb.bsdf` and the fit of glTF's model to it, `felt.fit.json`."""
    path = tmp_path_factory.mktemp("target")
    write_bsdf(path / "felt_rgb.bsdf", measured("syn_felt_green"))
    (outcome,) = fits.fit_files([path / "felt_rgb.bsdf"], path / "felt.fit.json", FitSettings(target="gltf"))
    assert outcome.failure is None
    return path


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def changed(folder, path, change, *, is_signed=False):
    """A copy of the fit whose entry `target` somebody has changed."""
    content = json.loads((folder / "felt.fit.json").read_text())
    change(content["target"])
    path.write_text(json.dumps(fit_json.signed(content) if is_signed else content))
    return path


def test_the_parameters_and_errors_are_those_of_a_direct_export(folder, tmp_path):
    entry = fit_json.read(folder / "felt.fit.json")["target"]
    made, mapped = (
        exports.export(
            exports.subject_of(folder / "felt_rgb.bsdf"),
            TARGETS["gltf"],
            tmp_path / "x.glb",
            is_direct=is_direct,
        ).export
        for is_direct in (True, False)
    )
    assert entry["parameters"] == made["parameters"]
    assert (entry["ciede2000"], entry["mapped_ciede2000"]) == (made["ciede2000"], mapped["ciede2000"])
    assert entry["principled_ciede2000"] == made["principled_ciede2000"]
    assert entry["ciede2000"] < entry["mapped_ciede2000"]
    assert 0.0 < entry["residual"] < entry["mapped_residual"] < 1.0
    assert entry["against"] == "measured file"


def test_a_fit_of_the_target_s_model_is_written_without_fitting_again(folder, tmp_path, monkeypatch):
    def fit_again(*_, **__):
        raise AssertionError

    monkeypatch.setattr(exports, "fit_target", fit_again)
    monkeypatch.setattr(exports, "fit_bsdf", fit_again)
    fit, output = folder / "felt.fit.json", tmp_path / "x.glb"
    entry = fit_json.read(fit)["target"]
    for words in ([], ["--direct"], ["--against", folder / "felt_rgb.bsdf"]):
        result = run("export", fit, "-o", output, "--json", "-", *words)
        assert result.exit_code == 0, result.output
        (made,) = json.loads(result.stdout)["exports"]
        assert (made["method"], made["against"]) == ("direct", "measured file")
        assert made["ciede2000"] == pytest.approx(entry["ciede2000"], rel=1e-9)
        assert made["principled_ciede2000"] == pytest.approx(entry["principled_ciede2000"], rel=1e-9)
        found = gltf_parameters(read_glb(output)[0]["materials"][0])
        assert all(
            found[name] == pytest.approx(value, abs=1e-6) for name, value in entry["parameters"].items()
        )


def test_a_fit_of_another_model_is_refused_in_one_line(folder, tmp_path):
    result = run("export", folder / "felt.fit.json", "-o", tmp_path / "x.mtlx")
    assert isinstance(result.exception, UsageError)
    assert "felt.fit.json: a fit of the model of 'gltf', expected openpbr" in str(result.exception)
    assert not (tmp_path / "x.mtlx").exists()


@pytest.mark.parametrize(("fitted", "exported"), [("blender", "blender-json"), ("usd", "usd-materialx")])
def test_targets_of_one_model_share_its_fits(folder, tmp_path, fitted, exported):
    values = TARGETS[fitted].parameters(Principled((0.3, 0.2, 0.1)))

    def change(entry):
        entry.update(name=fitted, parameters=values)

    fit = changed(folder, tmp_path / "x.fit.json", change, is_signed=True)
    made = exports.export(exports.subject_of(fit), TARGETS[exported], tmp_path / "x").export
    assert made["parameters"] == values


@pytest.mark.parametrize(
    ("fitted", "suffix", "expected"),
    [
        ("unreal", ".json", "unreal"),
        ("blender", ".json", "blender-json"),
        ("standard-surface", ".mtlx", "standard-surface"),
        ("usd-materialx", ".usda", "usd-materialx"),
        ("usd", ".usda", "usd"),
        ("gltf", ".mtlx", "openpbr"),  # which is refused then, as another model
    ],
)
def test_without_a_target_the_fit_s_is_written(folder, tmp_path, fitted, suffix, expected):
    fit = changed(folder, tmp_path / "x.fit.json", lambda entry: entry.update(name=fitted))
    assert exports.target_for(None, tmp_path / f"x{suffix}", fit).name == expected
    with pytest.raises(UsageError, match="several targets are JSON"):
        exports.target_for(None, tmp_path / "x.json", folder / "felt.fit.json")


def test_the_errors_of_a_fit_that_somebody_changed_are_measured_again(folder, tmp_path):
    fit = changed(
        folder, tmp_path / "x.fit.json", lambda entry: entry["parameters"].update(roughnessFactor=0.05)
    )
    with pytest.raises(UsageError, match=r"changed since it was fitted.*--against"):
        exports.subject_of(fit)
    subject = exports.subject_of(fit, folder / "felt_rgb.bsdf")
    made = exports.export(subject, TARGETS["gltf"], tmp_path / "x.glb").export
    assert made["ciede2000"] > 1.1 * fit_json.read(fit)["target"]["ciede2000"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p.update(roughnessFactor=1.5), r"roughnessFactor is not a number from 0 to 1; correct it"),
        (lambda p: p.update(roughnessFactor=True), r"roughnessFactor is not a number"),
        (lambda p: p.update(baseColorFactor=0.5), r"baseColorFactor is not 3 numbers from 0 to 1"),
        (lambda p: p.update(baseColorFactor=[0.5, 0.5, -0.5]), r"baseColorFactor is not 3 numbers"),
        (lambda p: p.update(ior=0.9), r"ior is not a number from 1 to 2"),
        (lambda p: p.update(colour=1.0), r"missing or unknown: colour"),
        (lambda p: p.pop("ior"), r"missing or unknown: ior"),
    ],
)
def test_parameters_that_the_target_does_not_have_are_named(folder, tmp_path, change, words):
    fit = changed(folder, tmp_path / "x.fit.json", lambda entry: change(entry["parameters"]), is_signed=True)
    with pytest.raises(FileFormatError, match=r"x.fit.json: target.parameters.*" + words):
        exports.export(exports.subject_of(fit), TARGETS["gltf"], tmp_path / "x.glb")


def test_an_entry_that_is_no_fit_of_a_model_is_named(folder, tmp_path):
    fit = changed(folder, tmp_path / "x.fit.json", lambda entry: entry.update(against="a friend"))
    with pytest.raises(FileFormatError, match=r"target.against is \"a friend\", expected measured file or"):
        fit_json.read(fit)


def test_a_second_run_keeps_the_fit_of_the_same_target_alone(folder, tmp_path, monkeypatch):
    target = changed(folder, tmp_path / "x.fit.json", lambda entry: None)
    (kept,) = fits.fit_files([folder / "felt_rgb.bsdf"], target, FitSettings(target="gltf"))
    assert kept.was_there
    monkeypatch.setattr(fits, "with_target", lambda content, target, *_: content | {"target": None})
    for other in ("openpbr", None):
        (again,) = fits.fit_files([folder / "felt_rgb.bsdf"], target, FitSettings(target=other))
        assert (again.failure, again.was_there) == (None, False)
    assert run("export", target, "-o", tmp_path / "x.mtlx").exit_code == 0  # now a fit of principled


def test_the_command_shows_the_target_s_parameters_and_errors(folder, tmp_path, monkeypatch):
    words = ["fit", folder / "felt_rgb.bsdf", "--target", "gltf", "-o", folder / "felt.fit.json"]
    result = run(*words)
    assert result.exit_code == 0, result.output
    entry = fit_json.read(folder / "felt.fit.json")["target"]
    assert "the model of gltf) (up to date)" in result.stdout
    assert f"{entry['ciede2000']:.2f}, against the measured file" in result.stdout
    assert f"{entry['parameters']['roughnessFactor']:.4g}" in result.stdout
    write_bsdf(tmp_path / "copper_rgb.bsdf", measured("syn_metal_copper"))
    monkeypatch.setattr(fits, "with_target", lambda content, *_: content | {"target": entry})
    words = [
        "fit", tmp_path / "copper_rgb.bsdf", folder / "felt_rgb.bsdf", "--target", "gltf", "-o", tmp_path, "-j", 1
    ]  # fmt: skip
    lines = run(*words).stdout.splitlines()
    assert lines[0].split() == ["material", "CIEDE2000", "mapped", "of", "principled"]
    assert {line.split()[0] for line in lines[1:3]} == {"copper", "felt"}


def test_a_prediction_is_fitted_too(folder, tmp_path, monkeypatch):
    entry = fit_json.read(folder / "felt.fit.json")["target"]
    seen = []

    def with_target(content, target, material, against):
        seen.append((target.name, against, material.bands.is_rgb))
        return fit_json.signed(content | {"target": entry | {"against": against}})

    monkeypatch.setattr(fits, "with_target", with_target)
    words = ["fit", "--latent", NAMES[0], "-M", small_model(tmp_path), "--target", "gltf"]
    result = run(*words, "-o", tmp_path / "x.fit.json")
    assert result.exit_code == 0, result.output
    assert seen == [("gltf", "prediction", True)]
    result = run("export", tmp_path / "x.fit.json", "-o", tmp_path / "x.glb")
    assert "against the prediction" in result.stdout


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"family": principled(["roughness"])}, "--free or --bsdf: not with --target"),
        ({"method": "adam", "wide_colours": True}, "--method, --wide-colours: not with --target"),
        ({"metric": "log"}, "--metric: not with --target"),
        ({"noise": 0.1}, "--noise: not with --target"),
        ({"sample": "a"}, "--sample: not with --target"),
        ({"target": "maya"}, "no target is called 'maya', expected one of gltf"),
    ],
)
def test_settings_of_other_fits_are_refused(settings, words):
    with pytest.raises(UsageError, match=words):
        FitSettings(**({"target": "gltf"} | settings))


def test_what_no_ball_can_be_made_of_is_refused(tmp_path):
    (outcome,) = fits.fit_files(
        [zemax_file(tmp_path / "x.brdf")], tmp_path / "x.fit.json", FitSettings(target="usd")
    )
    assert "expected a .bsdf for --target" in outcome.failure
    assert not (tmp_path / "x.fit.json").exists()
    result = run("fit", tmp_path / "x_rgb.bsdf", "--target", "usd", "--picture")
    assert "--picture draws Mitsuba's BSDF" in str(result.exception)
