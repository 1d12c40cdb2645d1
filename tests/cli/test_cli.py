"""The command line: exit status, one-line errors, JSON, pipes, interruption."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import REPOSITORY
from helpers.sample_files import write_samples
from helpers.small_library import NAMES, measured, small_library, small_model

from manifold.brdf.measured import MeasuredBRDF
from manifold.cli.application import COMMANDS, GROUPS
from manifold.core.directions import from_spherical
from manifold.core.metrics import relative_error
from manifold.formats.tensor_file import read_tensors, write_tensors
from manifold.gp.encoding import encoding_pairs
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.model.manifold import Manifold

RUN = "import sys; from manifold.__main__ import run; run(sys.argv[1:])"


def start(*arguments, cwd, **options):
    return subprocess.Popen(
        [sys.executable, "-c", RUN, *map(str, arguments)],
        cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def manifold(*arguments, cwd):
    """Status, stdout and stderr of the command in a process of its own."""
    process = start(*arguments, cwd=cwd)
    out, err = process.communicate(timeout=180)
    return process.returncode, out, err


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with `library.zarr` and `model.h5`."""
    return small_model(tmp_path_factory.mktemp("cli")).parent


def one_line(err):
    assert err.count("\n") == 1, err
    assert err.startswith("manifold: ")
    assert "Traceback" not in err
    return err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_with_an_example(run, tmp_path, command):
    status, out, _ = run(command, "--help", cwd=tmp_path)
    assert status == 0
    assert f"Example: manifold {command}" in out
    assert "{manifold" not in out  # names of registries are filled in
    assert "[[" not in out  # brackets around optional words are Typer's own
    assert not re.search(r"<(path|str|int|float|list|int range)\b", out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["predic"], "predict"),
        (["predict", "--latnt", "0,0"], "--latent"),
        (["predict"], "no point is given"),
        (["embed", "--latent-dim", "0"], "latent-dim"),
        (["embed", "--optimizer", "dls"], "found --optimizer dls, which works only with --kind gplvm"),
        (["predict", "--latent", "0.3", "1.2"], "coordinates have commas and no blanks, such as 0.3,1.2"),
        (["complete", "--lab", "40", "50", "30"], "a colour has commas, such as 50,20,10"),
        (["calibrate", "samples"], "pairs of files or folders"),
        (["embed", "--kind", "gplvm", "--kernel", "cubic"], "matern32"),
        (
            ["embed", "--kind", "gplvm", "--mapping", "cuberoot"],
            "expected one of identity, cube-root, log",
        ),
        (["embed", "--mapping", "cube-root"], "which works only with --kind gplvm"),
        (["embed", "--grid", "hikichi"], "which works only with --kind gplvm"),
        (["embed", "--kernel", "se"], "found --kernel se, which works only with --kind gplvm"),
        (["embed", "--mu", "1e-3"], "found --mu 0.001, which works only with --kind gplvm"),
        (["embed", "--mapping", "auto"], "found --mapping auto, which works only with --kind gplvm"),
        (
            ["embed", "--kind", "gplvm", "--landmarks", "9"],
            "found --landmarks 9, which works only with --kind blend",
        ),
        (["embed", "--kind", "gplvm", "--optimizer", "adam"], "optimizer 'adam', expected dls or l-bfgs"),
        (["embed", "--kind", "gplvm", "--grid", "huge"], "no grid is called"),
        (["embed", "--as-published", "--mu", "0.1"], "expected none: it fixes them all"),
        (["embed", "--kind", "gplvm", "--mu", "0"], "mu = 0.0, expected 1e-10 to 1e+06"),
        (["report", "--grid", "huge"], "hikichi"),
        (["render", "--size", "1"], "--size"),
        (["corpus", "x", "--seed", "one"], "--seed"),
        (["corpus"], "Missing argument 'FOLDER'"),
        (["predit"], "'predit' (did you mean 'predict'?); see `manifold --help`"),
        (["predict", "--latnt", "0"], "No such option: --latnt (did you mean --latent?); see"),
        (["predict", "--name", "x"], "No such option: --name; see"),
        (["predict", "0.3", "0.2"], "write coordinates with a comma: 0.3,0.2; see"),
        (["predict", "-0.3", "-0.2", "1"], "write coordinates with a comma: -0.3,-0.2,1; see"),
        (
            ["complete", "readings", "--report"],
            "'--report' requires an argument; see `manifold complete --help`",
        ),
        (["export", "cardboard", "--target", "gltff"], "unreal, unity, shader"),
        (["complete", "--lab", "40,500,3"], "colour '40,500,3': no reflectance has it"),
        (["import", ""], "an empty argument"),
    ],
)
def test_mistyped_commands_and_options_are_usage_errors(run, tmp_path, arguments, words):
    status, out, err = run(*arguments, cwd=tmp_path)
    assert (status, out) == (2, "")
    assert words in one_line(err)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "expected", "words"),
    [
        (["embed"], 1, "manifold import"),
        (["embed", "-o", "absent/m.h5"], 1, "absent/m.h5: cannot write this file"),
        (["predict", "--latent", "0,0", "-M", "absent.h5"], 1, "manifold embed"),
        (["report", "-M", "absent.h5"], 1, "manifold embed"),
        (["predict", "cardboard", "-M", "absent.h5"], 1, "absent.h5: no such model"),
        (["info", "absent.bsdf"], 1, "absent.bsdf: no such file"),
        (
            ["render", "0,0", "-M", "built-in", "--environment", "absent.exr"],
            1,
            "manifold: absent.exr: no such file",
        ),
        (["slices", "absent.bsdf"], 1, "absent.bsdf: no such file"),
        (["import", "absent"], 1, "absent"),
        (["complete", "absent"], 1, "give readings files, or folders that contain them"),
        (["import", "."], 1, "bsdf"),
        (["fetch", "satin_golt"], 2, "satin_gold"),
        (["info", "x.txt", "--verify"], 2, "only libraries can be verified"),
        (["info", "x.txt"], 1, "found a text file"),
        (["info", "."], 1, "without zarr.json"),
        (["embed", "-L", "x.txt"], 1, "which is a folder"),
        (["report", "-M", "x.txt"], 1, "unknown or damaged header"),
        (["report", "-M", "."], 1, "a folder, expected a model"),
        (["demo", "x.txt"], 1, "x.txt"),
        (["budget", "--example", "felt", "-o", "felt.png"], 2, "expected a folder; --picture draws"),
        (["corpus", "x.txt/sub"], 1, "cannot make this folder"),
        (["fetch", "satin_gold", "--base-url", "ftp://x"], 2, "http"),
    ],
)
def test_an_empty_folder_gives_one_line_that_says_what_to_do(run, tmp_path, arguments, expected, words):
    if any(argument.startswith("x.txt") for argument in arguments):
        (tmp_path / "x.txt").write_text("just some text that is no tensor file\n" * 9)
    status, out, err = run(*arguments, cwd=tmp_path)
    assert status == expected
    assert out == ""
    assert words in one_line(err)


def test_imports_embeddings_and_reports_say_in_json_what_they_did(run, tmp_path):
    files = tmp_path / "files"
    files.mkdir()
    for name in NAMES[:4]:
        write_bsdf(files / f"{name}_rgb.bsdf", measured(name))
    assert run("import", "files", cwd=tmp_path)[0] == 0
    status, out, _ = run("import", "files", "--json", "i.json", cwd=tmp_path)
    assert status == 0
    assert json.loads((tmp_path / "i.json").read_text())["skipped"] == sorted(NAMES[:4])
    assert run("embed", "--json", "e.json", cwd=tmp_path)[0] == 0
    assert set(json.loads((tmp_path / "e.json").read_text())["latents"]) == set(NAMES[:4])
    status, out, _ = run("report", "--json", "r.json", "--picture", cwd=tmp_path)
    assert status == 0
    assert "synthetic" in out
    assert (tmp_path / "model.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "r.json").read_text())["methods"][0]["errors"]["rmse"] == [0.0] * 4
    assert "all hashes match" in run("info", "library.zarr", "--verify", cwd=tmp_path)[1]


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "model.h5"),
        ("info", "library.zarr"),
        ("predict", "--latent", "0,0", "-o", "j_rgb.bsdf"),
    ],
)
def test_json_on_stdout_stands_alone(run, folder, arguments):
    status, out, err = run(*arguments, "--json", "-", cwd=folder)
    assert (status, err) == (0, "")
    assert isinstance(json.loads(out), dict)


@pytest.mark.parametrize(("latent", "words"), [("1,2,3", "expected 2"), ("1e200,0", "at most 1e+09")])
def test_latents_that_are_none_are_usage_errors(run, folder, latent, words):
    status, out, err = run("predict", "--latent", latent, "-o", "none_rgb.bsdf", cwd=folder)
    assert (status, out) == (2, "")
    assert words in one_line(err)
    assert not (folder / "none_rgb.bsdf").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "model.h5", "--json", "absent/x"), ("report", "--json", "library.zarr"),
        ("embed", "-M", "absent/m.h5"), ("embed", "-M", "library.zarr"),
        *(("predict", "--latent", "0,0", "-o", f) for f in ("x.png", "absent/x.bsdf", "model.h5/x.bsdf", "_rgb.bsdf")),
    ],
)  # fmt: skip
def test_files_that_cannot_be_written_are_refused_before_the_work(run, folder, monkeypatch, arguments):
    def fail(*_, **__):
        pytest.fail("the work was done first")

    monkeypatch.setattr("manifold.evaluate.report.Manifold.load", fail)
    monkeypatch.setattr("manifold.model.embedding.Embedding.fit", fail)
    status, out, err = run(*arguments, cwd=folder)
    reasons = {
        "expected one of .png": 2,
        "cannot write this file": 1,
        "in the library": 2,
        "ends in .bsdf": 2,
    }
    assert (status, out) in [(code, "") for reason, code in reasons.items() if reason in one_line(err)]


@pytest.fixture
def moved(folder, tmp_path):
    """A folder where the model's library has another name."""
    shutil.copytree(folder / "library.zarr", tmp_path / "elsewhere.zarr")
    shutil.copy(folder / "model.h5", tmp_path / "model.h5")
    return tmp_path


def test_a_library_that_has_moved_can_be_named(run, moved):
    arguments = ("predict", "--latent", "0,0", "-o", "p_rgb.bsdf")
    status, _, err = run(*arguments, cwd=moved)
    assert status == 1
    assert "its library is not at" in one_line(err)
    status, _, err = run(*arguments, "--library", "elsewhere.zarr", cwd=moved)
    assert (status, err) == (0, "")


def test_a_library_that_lost_a_material_is_one_error(run, moved):
    shutil.rmtree(moved / "elsewhere.zarr" / "materials" / NAMES[0])
    status, _, err = run("predict", "--latent", "0,0", "-o", "p_rgb.bsdf", "-L", "elsewhere.zarr", cwd=moved)
    assert status == 1
    assert f"lacks 1 of the {len(NAMES)} materials" in one_line(err)


def test_a_library_that_gained_a_material_is_one_warning(run, moved):
    small_library(moved / "more", names=("syn_satin_blue",), library=moved / "elsewhere.zarr")
    status, _, err = run("info", "model.h5", "-L", "elsewhere.zarr", cwd=moved)
    assert status == 0
    assert "warning: elsewhere.zarr differs from the library that model.h5 was fitted to" in one_line(err)
    status, out, _ = run("predict", "--latent", "0,0", "-L", "elsewhere.zarr", "--json", "-", cwd=moved)
    document = json.loads(out)
    assert "differs from the library that model.h5 was fitted to" in document["warnings"][0]
    assert document["warnings"][0] in document["diagnostics"]
    status, out, err = run("predict", "--latent", "0,0", "-L", "elsewhere.zarr", "--strict", cwd=moved)
    assert (status, out) == (1, "")
    assert "differs from the library that model.h5 was fitted to" in one_line(err)


def test_control_characters_of_files_do_not_reach_the_terminal(run, tmp_path):
    description = b"red \x1b[31m bell\x07 \xff no text"
    tensors = dict(read_tensors(write_samples(tmp_path, 1)[0]))
    tensors["description"] = np.frombuffer(description, np.uint8)
    write_tensors(tmp_path / "odd_spec.bsdf", tensors)
    status, out, _ = run("info", "odd_spec.bsdf", cwd=tmp_path)
    assert status == 0
    assert r"red \x1b[31m bell\x07 \udcff no text" in out
    status, _, err = run("info", "absent\x1b[31m", cwd=tmp_path)
    assert status == 2
    assert "\x1b" not in one_line(err)
    run("import", "odd_spec.bsdf", cwd=tmp_path)
    status, out, _ = run("info", "library.zarr", cwd=tmp_path)
    assert status == 0
    assert "\x1b" not in out


def test_a_damaged_material_is_named_with_its_remedy(run, moved):
    (moved / "elsewhere.zarr" / "materials" / NAMES[1] / "spectra" / "c.0.0.0.0.0").unlink()
    for arguments in (("info", "elsewhere.zarr", "--verify"), ("report", "-L", "elsewhere.zarr")):
        status, _, err = run(*arguments, cwd=moved)
        assert status == 1
        assert NAMES[1] in one_line(err)
        assert "import its file again" in err
        assert err.count("import its file again") == 1


@pytest.mark.parametrize(("count", "latent_dim"), [(1, 1), (2, 1), (3, 2), (3, 3)])
def test_tiny_libraries_work_or_say_what_they_lack(run, tmp_path, count, latent_dim):
    small_library(tmp_path, names=NAMES[:count])
    status, out, err = run("embed", "-q", latent_dim, cwd=tmp_path)
    if latent_dim >= count:
        assert status == 2
        assert "import more" in one_line(err)
        return
    assert status == 0
    status, out, err = run("report", "--picture", "--json", "report.json", cwd=tmp_path)
    if count == 2:
        assert status == 2
        assert "leave one out" in one_line(err)
    else:
        assert (status, err) == (0, "")
        assert f"{count} materials" in out
        assert len(json.loads((tmp_path / "report.json").read_text())["names"]) == count
    latent = ",".join(["-0.1"] * latent_dim)  # begins like an option, also in one dimension
    assert run("predict", latent, "-o", "p_rgb.bsdf", cwd=tmp_path)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "blended from the surrounding materials"),
        (["--like", "syn_felt_orange"], "like syn_felt_orange"),
        (["--srgb", "0.5,0.6,0.7", "--physical"], "sRGB 0.5,0.6,0.7"),
    ],
)
def test_a_structure_is_predicted_in_the_colour_asked_for(run, folder, arguments, words):
    code, out, _ = run("predict", "--latent", "0.1,0.1", "-o", "p.bsdf", *arguments, cwd=folder)
    assert code == 0
    assert words in out
    assert words in read_bsdf(folder / "p.bsdf").description


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--srgb", "blue"], "#rrggbb"), (["--like", "syn_felt_green", "--srgb", "#ffffff"], "one of them")],
)
def test_colours_that_are_none_are_usage_errors(run, folder, arguments, words):
    code, out, err = run("predict", "--latent", "0,0", *arguments, cwd=folder)
    assert (code, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1


def test_a_located_file_is_written_as_the_map_reconstructs_it(run, folder, tmp_path):
    file, output = folder / "files" / "syn_satin_gold_rgb.bsdf", tmp_path / "again_rgb.bsdf"
    code, out, _ = run("locate", file, "-o", output, "--json", "-", cwd=folder)
    found = json.loads(out)
    model = Manifold.load(folder / "model.h5")
    predicted = model.predict(found["latent"], np.array(found["colours"]))
    wi, wo = _some_pairs()
    assert code == 0
    assert found["nearest"][0][0] == "syn_satin_gold"
    assert np.shape(found["colours"]) == (2, 3)  # path coordinates, and gains
    assert found["path"] == str(output)
    assert MeasuredBRDF(read_bsdf(output)).eval(wi, wo) == pytest.approx(predicted.eval(wi, wo), rel=0.05)
    assert f"latent ({','.join(found['coordinates'])})".replace(",", ", ") in read_bsdf(output).description


def test_a_file_is_reconstructed_from_a_library_with_and_without_itself(run, folder, tmp_path):
    file = folder / "files" / "syn_satin_gold_rgb.bsdf"
    made = {}
    for name, without in (("with", ()), ("without", ("--without", "syn_satin_gold"))):
        output = tmp_path / f"{name}_rgb.bsdf"
        code, out, err = run("reconstruct", file, *without, "-o", output, "--json", "-", cwd=folder)
        assert code == 0, err
        made[name] = json.loads(out)
        error = relative_error(*_two_materials(file, output))
        assert error == pytest.approx(made[name]["errors"]["linear"], abs=0.05)
    assert (made["with"]["materials"], made["without"]["materials"]) == (len(NAMES), len(NAMES) - 1)
    assert made["with"]["parts"][0][0] == "syn_satin_gold"
    assert "syn_satin_gold" not in dict(made["without"]["parts"])
    assert made["with"]["errors"]["ball"] < 0.1 < made["without"]["errors"]["ball"]
    assert any("leave it out" in note for note in made["with"]["diagnostics"])
    assert not any("leave it out" in note for note in made["without"]["diagnostics"])


def test_materials_are_held_out_of_a_model(run, folder, tmp_path):
    model = tmp_path / "fewer.h5"
    held_out = ("--without", "syn_satin_gold", "--without", "syn_gloss_red")
    assert run("embed", *held_out, "-M", model, cwd=folder)[0] == 0
    assert set(Manifold.load(model).names) == set(NAMES) - {"syn_satin_gold", "syn_gloss_red"}


@pytest.mark.parametrize(
    ("held_out", "words"),
    [
        (["satin"], "no material 'satin' in library.zarr; did you mean syn_satin_gold"),
        (NAMES, "no material is left"),
    ],
)
def test_held_out_names_are_materials_and_not_all(run, folder, held_out, words):
    words_of = [word for name in held_out for word in ("--without", name)]
    code, _, err = run("reconstruct", "files/syn_satin_gold_rgb.bsdf", *words_of, cwd=folder)
    assert code == 2
    assert words in one_line(err)
    assert not (folder / "reconstructed.bsdf").exists()


def _some_pairs():
    rng = np.random.default_rng(0)
    return (from_spherical(rng.uniform(0.1, 1.2, 50), rng.uniform(-3.0, 3.0, 50)) for _ in range(2))


def _two_materials(*files):
    """Values of two files on the grid of reports, and the weights of its pairs."""
    pairs = encoding_pairs()
    return *(MeasuredBRDF(read_bsdf(file)).eval(pairs.wi, pairs.wo) for file in files), pairs.cosines


def test_good_files_are_imported_beside_bad_ones(run, tmp_path):
    write_bsdf(tmp_path / "syn_felt_green_rgb.bsdf", measured("syn_felt_green"))
    (tmp_path / "broken_rgb.bsdf").write_bytes((tmp_path / "syn_felt_green_rgb.bsdf").read_bytes()[:5000])
    status, out, err = run("import", ".", cwd=tmp_path)
    assert status == 1
    assert re.search(r"imported +1\n", out)
    assert re.search(r"failed +1\n", out)
    assert "broken_rgb.bsdf" in one_line(err)
    for number in range(20):
        (tmp_path / f"bad{number}_rgb.bsdf").write_bytes(b"nothing")
    _, _, err = run("import", ".", "--json", "i.json", cwd=tmp_path)
    assert "21 failed" in one_line(err)
    assert "and 18 more" in err
    assert len(json.loads((tmp_path / "i.json").read_text())["failed"]) == 21


def test_debug_shows_the_traceback_wherever_it_stands(run, tmp_path):
    for arguments in (["--debug", "embed"], ["embed", "--debug"]):
        status, _, err = run(*arguments, cwd=tmp_path)
        assert status == 1
        assert "Traceback" in err


def test_a_pipe_gets_plain_text_and_may_close_early(folder):
    status, out, err = manifold("info", "library.zarr", cwd=folder)
    assert (status, err) == (0, "")
    assert "\x1b" not in out
    assert all(name in out for name in NAMES)
    process = start("info", "library.zarr", cwd=folder)
    process.stdout.close()
    assert process.wait(timeout=120) == 141
    assert process.stderr.read() == ""


def test_a_command_that_fails_leaves_no_json_of_an_earlier_run(run, folder, tmp_path):
    written = tmp_path / "results.json"
    assert run("info", "library.zarr", "--json", written, cwd=folder)[0] == 0
    assert written.exists()
    assert run("info", "absent.zarr", "--json", written, cwd=folder)[0] == 1
    assert not written.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "library.zarr"],
        ["info", "files/syn_gloss_red_rgb.bsdf"],
        ["predict", "0,0"],
        ["find", "syn_gloss_red"],
        ["locate", "syn_gloss_red"],
    ],
)
def test_the_reference_names_the_keys_of_json(run, folder, arguments):
    status, out, _ = run(*arguments, "--json", "-", cwd=folder)
    assert status == 0
    documented = re.findall(r"`(\w+)`", (REPOSITORY / "docs/reference/json.md").read_text(encoding="utf-8"))
    assert set(json.loads(out)) <= set(documented)
    assert json.loads(out)["schema"] == 1


def test_a_material_of_the_built_in_library_is_found_there(run, folder):
    status, _, err = run("find", "acrylic_felt_white", cwd=folder)
    assert status == 2
    assert "the built-in library holds it: add -L built-in" in one_line(err)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_stdout_is_one_error(folder):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", RUN, "info", "model.h5"]
        done = subprocess.run(command, cwd=folder, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert "No space left" in one_line(done.stderr)


def test_an_unexpected_error_is_one_line_that_asks_for_debug(run, folder, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr("manifold.evaluate.report.Manifold.load", fail)
    status, _, err = run("report", cwd=folder)
    assert status == 1
    assert "RuntimeError: first line second line; run again with --debug" in one_line(err)


def test_an_interruption_before_the_command_runs_is_one_line(run, monkeypatch, tmp_path):
    def interrupt(**_):
        raise KeyboardInterrupt

    monkeypatch.setattr("manifold.cli.application.Application.only", lambda *_: interrupt)
    status, _, err = run("corpus", "out", cwd=tmp_path)
    assert status == 130
    assert "interrupted" in one_line(err)


def test_an_interruption_that_compiled_code_wraps_is_an_interruption(run, monkeypatch, tmp_path):
    def interrupt(**_):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interruption:  # as CPython does in compiled code
            raise SystemError("returned a result with an exception set") from interruption

    monkeypatch.setattr("manifold.cli.application.Application.only", lambda *_: interrupt)
    status, _, err = run("corpus", "out", cwd=tmp_path)
    assert status == 130
    assert "interrupted" in one_line(err)


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_leaves_nothing_half_written(tmp_path, sent):
    process = start("corpus", "out", cwd=tmp_path)
    deadline = time.monotonic() + 150
    while not list(tmp_path.glob("out/[!.]*_spec.bsdf")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(sent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in err.splitlines()[-1]  # after a line of progress where the machine is busy
    files = sorted((tmp_path / "out").iterdir())
    assert files
    for path in files:
        read_bsdf(path)


def test_the_package_installs_no_global_module_named_cli(tmp_path):
    code = "import importlib.util, manifold.cli.main; print(importlib.util.find_spec('cli'))"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert out.stdout.strip() == "None"


def test_a_checkout_that_is_not_installed_runs_as_the_command(tmp_path):
    """Run Python without `site`: it then does not find packages that are installed in editable mode."""
    path = [str(REPOSITORY), *(entry for entry in sys.path if entry.endswith("site-packages"))]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(path)}
    done = subprocess.run(
        [sys.executable, "-S", "-m", "manifold", "info", "--help"],
        capture_output=True, text=True, cwd=tmp_path, env=env, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Usage: manifold info" in done.stdout


def test_python_runs_the_package_as_the_command(tmp_path):
    from manifold import __version__

    done = subprocess.run(
        [sys.executable, "-m", "manifold", "--version"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=True,
    )
    assert done.stdout == f"manifold {__version__}\n"


def test_every_folder_is_installed():
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    folders = {path.parent.relative_to(REPOSITORY) for path in (REPOSITORY / "manifold").rglob("*.py")}
    expected = {".".join(folder.parts) for folder in folders} | {"manifold.cli"}
    assert set(settings["tool"]["setuptools"]["packages"]) == expected


DIAGNOSED = {
    "expected",
    "materials",
    "is_extrapolation",
    "nearest",
    "plausibility",
    "diagnostics",
}


@pytest.mark.parametrize(
    ("arguments", "find"),
    [
        (["predict", "--latent", "0.3,-0.2", "-o", "d_rgb.bsdf"], lambda document: document),
        (
            ["slices", "0.3,-0.2"],
            lambda document: document["predictions"]["predicted at 0.3,-0.2"],
        ),
        (["map", "--mark", "0.3,-0.2"], lambda document: document["prediction"]),
        (
            ["render", "0.3,-0.2", "--size", "16", "--samples", "1"],
            lambda document: document["prediction"],
        ),
        (["fit", "0.3,-0.2", "--free", "roughness"], lambda document: document["predictions"][0]),
        (
            ["walk", "syn_felt_green", "syn_gloss_red", "--steps", "3"],
            lambda document: document["predictions"][0],
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
@pytest.mark.usefixtures("quick_pictures")
def test_every_command_that_predicts_says_what_to_expect(run, folder, arguments, find):
    status, out, err = run(*arguments, "--json", "-", cwd=folder)
    assert status == 0, err
    found = find(json.loads(out))
    assert set(found) >= DIAGNOSED
    model = Manifold.load(folder / "model.h5", folder / "library.zarr")
    if found["latent"] is None:  # a step of a walk
        assert found["expected"] is None
    else:
        assert found["expected"]["ball"] == float(model.expected_error(np.array(found["latent"])).ball)


def test_the_help_lists_every_command_once_under_its_group(run, tmp_path):
    _, out, _ = run("--help", cwd=tmp_path)
    listed = re.findall(r"^  ([a-z]+)  ", out, re.MULTILINE)
    assert sorted(listed) == sorted(COMMANDS)
    assert [title for title in GROUPS if f"\n{title}:\n" in out] == list(GROUPS)


@pytest.mark.parametrize("command", COMMANDS)
def test_no_help_shows_more_than_twenty_options(run, tmp_path, command):
    _, out, _ = run(command, "--help", cwd=tmp_path)
    _, whole, _ = run(command, "--help-all", cwd=tmp_path)
    shown, every = (re.findall(r"^  (?:-\w, )?(--[a-z-]+)", text, re.MULTILINE) for text in (out, whole))
    assert len(shown) <= 20
    assert set(shown) <= set(every)
    assert ("--help-all" in out) == (len(shown) < len(every))
