"""`manifold export`: sources, folders, resuming, losses, errors."""

from __future__ import annotations

import json
import shutil

import pytest
from helpers.exported_files import gltf_parameters, read_glb
from helpers.quick_fits import fit_quickly
from helpers.small_library import NAMES, measured, small_library
from matplotlib.image import imread
from typer.testing import CliRunner

from manifold.cli.main import app
from manifold.core import progress
from manifold.core.errors import ManifoldError, UsageError
from manifold.fit import exporting, fits
from manifold.fit.principled import fit_bsdf
from manifold.io_rgl import write_bsdf
from manifold.many.batch import batch
from manifold.model.manifold import Manifold
from manifold.registries import TARGETS
from manifold.render import fit_json
from manifold.render.bsdf_parameters import principled

COPPER = "syn_metal_copper"


pytestmark = pytest.mark.usefixtures("quick_pictures")


@pytest.fixture(autouse=True)
def short_fits(monkeypatch):
    fit_quickly(monkeypatch)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A file `copper_rgb.bsdf` and its fit."""
    path = tmp_path_factory.mktemp("exports")
    write_bsdf(path / "copper_rgb.bsdf", measured(COPPER))
    result = fit_bsdf(measured(COPPER), principled(["base_color", "metallic", "roughness"]))
    source = fit_json.FitSource("copper", file="copper_rgb.bsdf")
    fit_json.write_document(path / "copper_rgb.fit.json", fits.document(result, source))
    return path


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def test_a_fit_is_exported_with_its_loss_against_itself(folder, tmp_path):
    result = run("export", folder / "copper_rgb.fit.json", "-o", tmp_path / "x.glb", "--json", "-")
    assert result.exit_code == 0, result.output
    (made,) = json.loads(result.stdout)["exports"]
    assert made["against"] == "fit"
    assert made["principled_errors"] is None
    # A copper of principled is one of glTF, but for what scatters between facets.
    assert made["errors"]["ball"] < 1.5
    document, _ = read_glb(tmp_path / "x.glb")
    values = fit_json.read(folder / "copper_rgb.fit.json")["values"]
    found = gltf_parameters(document["materials"][0])
    # glTF's metals scatter light between facets as well, which the fit makes up for.
    assert found["baseColorFactor"] == pytest.approx(values["base_color"], abs=0.1)
    assert found["roughnessFactor"] == pytest.approx(values["roughness"], abs=0.05)
    assert document["materials"][0]["extras"]["errors"]["ball"] == made["errors"]["ball"]


def test_a_file_that_is_not_named_is_called_after_the_material(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {
        (): "copper.glb",
        ("--target", "blender"): "copper.py",
        ("--target", "openpbr"): "copper.mtlx",
        ("--target", "standard-surface"): "copper_standard-surface.mtlx",
    }
    for target, name in names.items():
        result = run("export", folder / "copper_rgb.fit.json", *target)
        assert result.exit_code == 0, result.output
        assert (tmp_path / name).is_file()
    assert len(list(tmp_path.iterdir())) == len(names)


def test_no_two_targets_share_the_name_of_a_file_or_a_picture(tmp_path):
    for names in (
        [path.name for path in exporting.paths_for(tmp_path, "x", list(TARGETS.values()))],
        [exporting.picture_of(tmp_path / f"x{each.file_suffix}", each).name for each in TARGETS.values()],
    ):
        assert len(set(names)) == len(TARGETS)
        assert "x.png" not in names  # of other commands


def test_a_fit_against_the_measured_file_says_what_both_models_lose(folder, tmp_path):
    subject = exporting.subject_of(folder / "copper_rgb.fit.json", folder / "copper_rgb.bsdf")
    made = exporting.export(subject, TARGETS["openpbr"], tmp_path / "x.mtlx").content
    assert made["against"] == "measured file"
    assert made["principled_errors"]["ball"] > 0.0
    assert abs(made["errors"]["ball"] - made["principled_errors"]["ball"]) < 1.0


def test_usd_with_materialx_holds_a_fit_of_each_surface(folder, tmp_path, monkeypatch):
    values = {"usd-materialx": {"roughness": 0.123}, "openpbr": {"specular_roughness": 0.456}}
    monkeypatch.setattr(exporting, "fit_target", lambda target, start, samples: start | values[target.name])
    subject = exporting.subject_of(folder / "copper_rgb.fit.json", None)
    exporting.export(subject, TARGETS["usd-materialx"], tmp_path / "x.usda")
    text = (tmp_path / "x.usda").read_text()
    assert "roughness = 0.123" in text
    assert "specular_roughness = 0.456" in text


def test_an_export_that_is_not_a_close_fit_has_a_note(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(exporting, "VISIBLE", 2.0)  # between the two
    write_bsdf(tmp_path / "felt_rgb.bsdf", measured("syn_felt_green"))
    found = [
        exporting.export(
            exporting.subject_of(folder / "copper_rgb.fit.json", against),
            TARGETS["gltf"],
            tmp_path / "x.glb",
        )
        for against in (folder / "copper_rgb.bsdf", tmp_path / "felt_rgb.bsdf")
    ]
    said = [any(note.startswith("not a close fit") for note in one.notes) for one in found]
    assert [one.content["errors"]["ball"] > 2.0 for one in found] == said == [False, True]


def test_a_measured_file_is_fitted_on_the_way(folder, tmp_path):
    words = ["-o", tmp_path / "x.json", "--target", "unreal", "--picture"]
    result = run("export", folder / "copper_rgb.bsdf", *words)
    assert result.exit_code == 0, result.output
    assert "CIEDE2000 of the ball" in result.stdout
    assert "principled: not a close fit" not in " ".join(result.stdout.split())
    assert "Mitsuba's principled" in result.stdout
    assert "in the lights of the fit" in " ".join(result.stdout.split())
    assert imread(tmp_path / "x_unreal.png").shape[0] > 400
    content = json.loads((tmp_path / "x.json").read_text())
    assert content["source"]["file"] == "copper_rgb.bsdf"
    assert content["parameters"]["Metallic"] > 0.5


def test_a_prediction_is_exported(tmp_path):
    library = small_library(tmp_path)
    Manifold.fit(exporting.Library.open(library), calibrate=False).save(tmp_path / "model.h5")
    words = ["export", "0.1,0.1", "-M", tmp_path / "model.h5", "-o", tmp_path / "between.usda"]
    result = run(*words, "--json", tmp_path / "report.json")
    assert result.exit_code == 0, result.output
    (made,) = json.loads((tmp_path / "report.json").read_text())["exports"]
    assert (made["against"], made["target"]) == ("prediction", "usd")
    assert len(made["source"]["latent"]) == 2
    assert made["errors"]["ball"] is not None


def exported(source, out):
    return batch(exporting.exports(TARGETS["gltf"]), exporting.export_sources(source), out).outcomes


def test_a_folder_is_exported_once_and_resumed(folder, tmp_path):
    source = tmp_path / "source"
    shutil.copytree(folder, source)
    shutil.copy(source / "copper_rgb.fit.json", source / "other.fit.json")
    (source / "broken.fit.json").write_text("{}")
    done = []
    with progress.listen(lambda *step: done.append(step)):
        outcomes = exported(source, tmp_path / "out")
    assert [(o.name, o.failure is None, o.was_there) for o in outcomes] == [
        ("broken", False, False), ("copper", True, False), ("other", True, False),
    ]  # fmt: skip
    assert [step[:2] for step in done] == [(1, 3), (2, 3), (3, 3)]
    assert outcomes[1].content["against"] == "measured file"  # the fit, beside the file of that name
    assert outcomes[2].content["against"] == "fit"
    (source / "broken.fit.json").unlink()
    (tmp_path / "out" / "other.glb").write_bytes(b"changed")
    before = (tmp_path / "out" / "copper.glb").stat().st_mtime_ns
    again = exported(source, tmp_path / "out")
    assert [(o.name, o.was_there) for o in again] == [("copper", True), ("other", False)]
    assert (tmp_path / "out" / "copper.glb").stat().st_mtime_ns == before
    assert read_glb(tmp_path / "out" / "other.glb")[0]["materials"][0]["name"] == "copper"


def test_a_library_is_exported(tmp_path, monkeypatch, folder):
    library = small_library(tmp_path, names=NAMES[:1])
    fitted_as_copper(monkeypatch, folder)
    result = run("export", library, "-o", tmp_path / "out", "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    assert {path.name for path in (tmp_path / "out").glob("[!.]*")} == {
        f"{NAMES[0]}.glb", "exports.csv", "exports.json", "exports.jsonl"
    }  # fmt: skip
    (made,) = json.loads((tmp_path / "r.json").read_text())["exports"]
    assert made["material"] == NAMES[0]
    assert made["errors"]["ball"] < 3.0  # though it began as copper
    assert "kept" in run("export", library, "-o", tmp_path / "out").stdout


def fitted_as_copper(monkeypatch, folder):
    """No file is fitted: each begins as the copper of the folder."""
    content = fit_json.read(folder / "copper_rgb.fit.json")
    monkeypatch.setattr(exporting, "fit_bsdf", lambda samples: None)
    monkeypatch.setattr(exporting.fits, "document", lambda result, source: content)


def test_a_pack_has_a_page_of_balls_with_differences(tmp_path, monkeypatch, folder):
    library = small_library(tmp_path, names=NAMES[:2])
    fitted_as_copper(monkeypatch, folder)
    out = tmp_path / "pack"
    result = run("export", library, "--pack", out, "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    page = (out / "index.html").read_text()
    for made in json.loads((tmp_path / "r.json").read_text())["exports"]:
        name, errors = made["material"], made["errors"]
        assert f'<a href="{name}.glb">{name}</a>' in page
        assert f"{errors['ball']:.1f}, in {errors['worst_light']} {errors['worst']:.1f}" in page
        assert min(imread(out / "balls" / f"{name}.png").shape[:2]) > 300
    assert not (out / "exports.jsonl").exists()
    assert not (out / ".manifold.lock").exists()
    rows = (out / "exports.csv").read_text()
    assert ("not a close fit" in rows) == any(
        made["notes"] for made in json.loads((tmp_path / "r.json").read_text())["exports"]
    )


def test_a_page_of_a_pack_names_what_failed_and_keeps_its_index(folder, tmp_path):
    source, out = tmp_path / "source", tmp_path / "out"
    source.mkdir()
    shutil.copy(folder / "copper_rgb.fit.json", source / "copper.fit.json")
    (source / "broken.fit.json").write_text("{}")
    result = run("export", source, "--pack", out)
    assert result.exit_code != 0
    page = (out / "index.html").read_text()
    assert "1 materials for" in page
    assert "Not exported" in page
    assert "broken" in page
    assert (out / "exports.jsonl").exists()


def test_a_pack_of_one_material_is_refused(folder, tmp_path):
    result = run("export", folder / "copper_rgb.bsdf", "--pack", tmp_path / "pack")
    assert isinstance(result.exception, UsageError)
    assert "--pack works only with a library or a folder" in str(result.exception)


def test_a_name_that_is_no_file_s_on_every_system_fails_alone(folder, tmp_path):
    source, out = tmp_path / "source", tmp_path / "out"
    source.mkdir()
    for name in ("copper", "CON", "new\nline", ".hidden"):
        shutil.copy(folder / "copper_rgb.fit.json", source / f"{name}.fit.json")
    result = run("export", source, "-o", out)
    assert "'CON' cannot be the name of a material on every system" in str(result.exception)
    assert "\n" not in str(result.exception)
    assert [path.name for path in out.glob("*.glb")] == ["copper.glb"]


def test_two_files_of_one_name_are_refused(folder, tmp_path):
    for part in ("a", "b"):
        (tmp_path / part).mkdir()
        shutil.copy(folder / "copper_rgb.fit.json", tmp_path / part)
    with pytest.raises(UsageError, match="have the same name"):
        exported(tmp_path, tmp_path / "out")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "no material is given; give one"),
        (["copper_rgb.fit.json", "-o", "x.obj"], "suffix '.obj', expected one of .glb"),
        (["copper_rgb.fit.json", "-o", "x.json"], "several targets are JSON"),
        (["copper_rgb.fit.json", "-o", "x.glb", "--srgb", "#ff0000"], "work only with predictions"),
        (
            ["copper_rgb.bsdf", "-o", "x.glb", "--against", "copper_rgb.bsdf"],
            "works only with the JSON of a fit",
        ),
        (["nowhere.fit.json", "-o", "x.glb"], "no such file"),
        (["nowhere.bsdf", "-o", "x.glb"], "no such file"),
        (["copper_rgb.fit.json", "-o", "no/x.glb"], "cannot write this file"),
        ([".", "-o", "x.glb"], "named like a file, expected a folder"),
        ([".", "-o", "copper_rgb.bsdf"], "named like a file, expected a folder"),
    ],
)
def test_bad_requests_are_one_clear_error_each(folder, monkeypatch, words, expected):
    monkeypatch.chdir(folder)
    result = run("export", *words)
    assert isinstance(result.exception, ManifoldError), result.output
    assert expected in str(result.exception)
    assert not (folder / "x.glb").exists()


def test_an_empty_folder_is_one_clear_error(tmp_path):
    with pytest.raises(UsageError, match="neither a library nor a folder"):
        exported(tmp_path, tmp_path / "out")


def test_one_fit_serves_several_targets(folder, tmp_path, monkeypatch):
    fitted = []
    monkeypatch.setattr(
        exporting, "subject_of", lambda *a, of=exporting.subject_of: fitted.append(a) or of(*a)
    )
    words = ["--target", "gltf,unreal,unity", "-o", tmp_path / "out", "--json", "-"]
    result = run("export", folder / "copper_rgb.fit.json", *words)
    assert result.exit_code == 0, result.output
    assert len(fitted) == 1
    names = [
        "copper.glb",
        "copper_unreal.json",
        "copper_unity.json",
    ]  # of two that share a suffix, with the target
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    made = json.loads(result.stdout)["exports"]
    assert [one["target"] for one in made] == ["gltf", "unreal", "unity"]
    assert [one["colour_space"][:4] for one in made] == ["line", "line", "sRGB"]


def test_a_folder_is_exported_for_several_targets_once(folder, tmp_path, monkeypatch):
    shutil.copy(folder / "copper_rgb.fit.json", tmp_path)
    words = ["export", tmp_path, "--target", "gltf,usd", "-o", tmp_path / "out"]
    result = run(*words, "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    made = {path.name for path in (tmp_path / "out").glob("copper*")}
    assert made == {"copper.glb", "copper.usda"}
    (found,) = json.loads((tmp_path / "r.json").read_text())["exports"]
    assert set(found["targets"]) == {"gltf", "usd"}
    header = (tmp_path / "out" / "exports.csv").read_text().splitlines()[0]
    assert "gltf" in header
    assert "usd" in header
    assert "kept" in run(*words).stdout
    (tmp_path / "out" / "copper.usda").unlink()
    assert "kept" not in run(*words).stdout


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--target", "gltf,usd", "-o", "x.glb"], "expected a folder for the files of several targets"),
        (["--target", "gltf,obj"], "no target is called 'obj'"),
        (["--target", "gltf,usd", "--pack", "pack"], "--pack works only with one target, found gltf,usd"),
    ],
)
def test_several_targets_need_a_folder_and_names_of_targets(folder, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    result = run("export", folder / "copper_rgb.fit.json", *words)
    assert isinstance(result.exception, ManifoldError), result.output
    assert expected in str(result.exception)


def test_several_files_or_a_pattern_are_exported_into_a_folder(folder, tmp_path, monkeypatch):
    """Only the first match was exported, without a word."""
    monkeypatch.chdir(tmp_path)
    for name in ("a1", "a2"):
        shutil.copy(folder / "copper_rgb.fit.json", f"{name}.fit.json")
    for given in (["a*.fit.json"], ["a1.fit.json", "a2.fit.json"]):
        result = run("export", *given, "--target", "unity", "-o", "out")
        assert result.exit_code == 0, result.output
        assert {path.name for path in (tmp_path / "out").glob("a*")} == {"a1_unity.json", "a2_unity.json"}
    result = run("export", "a1.fit.json", "--target", "unity")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "a1_unity.json").exists()  # a1.json may be another command's
    assert "export for unity" in run("info", "a1_unity.json").stdout
    refusal = str(run("compare", "a1.fit.json", "a1_unity.json").exception)
    assert "a file for engines, which cannot be read back" in refusal
    assert "`manifold info a1_unity.json` states" in refusal
    assert "CIEDE2000" in run("info", "a1_unity.json").stdout


def test_several_targets_are_drawn_beside_the_material(folder, tmp_path):
    words = ["export", folder / "copper_rgb.fit.json", "--target", "gltf,unity,usd-materialx", "--picture"]
    result = run(*words, "-o", tmp_path, "--json", tmp_path / "r.json")
    assert result.exit_code == 0, result.output
    height, width = imread(tmp_path / "copper_exports.png").shape[:2]
    assert width > 1.5 * height
    *_, usd = json.loads((tmp_path / "r.json").read_text())["exports"]
    assert usd["beside"]["target"] == "openpbr"
    assert usd["beside"]["errors"]["ball"] < usd["errors"]["ball"] + 1.0
    assert "openpbr in the same file" in result.stdout
    assert "_Anisotropy" not in result.stdout  # which is 0


def test_openpbr_says_the_error_in_each_program_and_nothing_of_principled_s_notes(folder, tmp_path):
    result = run("export", folder / "copper_rgb.fit.json", "-o", tmp_path / "x.mtlx", "--target", "openpbr")
    assert result.exit_code == 0, result.output
    said = " ".join(result.stdout.split())
    assert "CIEDE2000 of the ball in MaterialX" in said
    assert "CIEDE2000 of the ball in openpbr-bsdf" in said
    assert "colour space linear Rec. 709" in said
    assert "principled:" not in said
    document = (tmp_path / "x.mtlx").read_text()
    assert "in MaterialX" in document
    assert "in openpbr-bsdf" in document


@pytest.mark.parametrize(("target", "engine"), [("unreal", "Unreal Engine"), ("unity", "Unity")])
def test_targets_that_were_never_compared_with_a_render_say_so(folder, tmp_path, target, engine):
    result = run("export", folder / "copper_rgb.fit.json", "-o", tmp_path / "x.json", "--target", target)
    caveat = f"never compared with a render of {engine}"
    assert caveat in " ".join(result.stdout.split())
    content = json.loads((tmp_path / "x.json").read_text())
    assert content["caveat"].startswith(caveat)
    assert "--target shader" in content["caveat"]
