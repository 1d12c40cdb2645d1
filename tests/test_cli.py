"""The command line: exit status, one-line errors, JSON, pipes, interruption."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import REPOSITORY
from small_library import NAMES, measured, small_library

from manifold.io_rgl import read_bsdf, write_bsdf

RUN = "import sys; from manifold.cli.main import run; run(sys.argv[1:])"
COMMANDS = ("demo", "corpus", "fetch", "import", "info", "embed", "predict", "report")


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


@pytest.fixture
def run(capsys, monkeypatch):
    """The command in this process, in a given folder: status, stdout, stderr."""
    from manifold.cli.main import run as run_main

    def call(*arguments, cwd):
        monkeypatch.chdir(cwd)
        with pytest.raises(SystemExit) as caught:
            run_main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return caught.value.code or 0, captured.out, captured.err

    return call


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with `library.zarr` and `model.h5` made by the command line."""
    path = tmp_path_factory.mktemp("cli")
    small_library(path)
    assert manifold("embed", cwd=path)[0] == 0
    return path


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


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_in_the_readme(command):
    assert f"manifold {command}" in (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_the_version_is_printed(run, tmp_path):
    status, out, _ = run("--version", cwd=tmp_path)
    assert status == 0
    assert re.fullmatch(r"manifold \d+\.\d+\.\d+\n", out)


def test_help_loads_nothing_heavy(tmp_path):
    code = "import sys; from manifold.cli.main import run\ntry: run(['--help'])\nexcept SystemExit: pass\n"
    code += "print([m for m in ('numpy', 'zarr', 'numba', 'matplotlib', 'colour') if m in sys.modules])"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert out.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["predic"], "predict"),
        (["predict", "--latnt", "0,0"], "--latent"),
        (["predict"], "--latent"),
        (["embed", "--latent-dim", "0"], "latent-dim"),
        (["embed", "--optimizer", "adam"], "l-bfgs"),
        (["report", "--grid", "huge"], "seed"),
    ],
)
def test_mistyped_commands_and_options_are_usage_errors(run, tmp_path, arguments, words):
    status, _, err = run(*arguments, cwd=tmp_path)
    assert status == 2
    assert words in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info"], "nothing there"),
        (["embed"], "manifold import"),
        (["predict", "--latent", "0,0"], "manifold embed"),
        (["report"], "manifold embed"),
        (["import", "absent"], "absent"),
        (["import", "."], "bsdf"),
        (["fetch", "satin_golt"], "satin_gold"),
        (["info", "x.txt", "--verify"], "only libraries can be verified"),
        (["info", "x.txt"], "tensor"),
    ],
)
def test_an_empty_folder_gives_one_line_that_says_what_to_do(run, tmp_path, arguments, words):
    if "x.txt" in arguments:
        (tmp_path / "x.txt").write_text("just some text that is no tensor file\n" * 9)
    status, out, err = run(*arguments, cwd=tmp_path)
    assert status == 1
    assert out == ""
    assert words in one_line(err)


def test_the_main_job_step_by_step(run, tmp_path):
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
    status, out, _ = run(
        "predict", "--latent", "-0.3,0.2", "-o", "p_rgb.bsdf", "--json", "p.json", cwd=tmp_path
    )
    assert status == 0
    assert "uncertainty" in out
    assert read_bsdf(tmp_path / "p_rgb.bsdf").spectra.shape == (1, 8, 3, 32, 32)
    assert json.loads((tmp_path / "p.json").read_text())["latent"] == [-0.3, 0.2]
    status, out, _ = run("report", "--json", "r.json", "--picture", "m.png", cwd=tmp_path)
    assert status == 0
    assert "synthetic" in out
    assert (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "r.json").read_text())["methods"][0]["rmse"] == [0.0] * 4
    for path in ("library.zarr", "model.h5", "p_rgb.bsdf"):
        status, out, _ = run("info", path, cwd=tmp_path)
        assert status == 0
        assert path in out
    assert "all hashes match" in run("info", "library.zarr", "--verify", cwd=tmp_path)[1]


def test_results_as_json_on_stdout_stand_alone_at_its_end(run, folder):
    status, out, _ = run("info", "model.h5", "--json", "-", cwd=folder)
    assert status == 0
    assert json.loads(out[out.index("{") :])["settings"]["latent_dim"] == 2


@pytest.mark.parametrize(
    ("latent", "words"),
    [("1", "expected 2"), ("1,2,3", "expected 2"), ("nan,0", "finite"), ("a,b", "numbers"), ("", "numbers")],
)
def test_latents_that_are_none_are_refused(run, folder, latent, words):
    status, _, err = run("predict", "--latent", latent, cwd=folder)
    assert status == 1
    assert words in one_line(err)


@pytest.mark.parametrize("output", ["x.png", "absent/x.bsdf"])
def test_predictions_need_a_place(run, folder, output):
    status, _, err = run("predict", "--latent", "0,0", "-o", output, cwd=folder)
    assert status == 1
    assert output in one_line(err)


def test_a_json_file_that_cannot_be_written_is_one_error(run, folder):
    status, _, err = run("info", "model.h5", "--json", "absent/x.json", cwd=folder)
    assert status == 1
    assert "absent/x.json" in one_line(err)


def test_a_far_latent_is_called_extrapolated(run, folder):
    status, out, _ = run("predict", "--latent", "40,-40", "-o", "far_rgb.bsdf", cwd=folder)
    assert status == 0
    assert "extrapolated" in out


def test_mixing_bands_is_refused(run, folder, tmp_path):
    from manifold import corpus

    write_bsdf(tmp_path / "syn_felt_pink_spec.bsdf", corpus.measure(corpus.isotropic_materials()[2]))
    status, _, err = run("import", tmp_path, cwd=folder)
    assert status == 1
    assert "RGB" in one_line(err)
    assert "195 bands" in err


def test_good_files_are_imported_beside_bad_ones(run, tmp_path):
    write_bsdf(tmp_path / "syn_felt_green_rgb.bsdf", measured("syn_felt_green"))
    (tmp_path / "broken_rgb.bsdf").write_bytes((tmp_path / "syn_felt_green_rgb.bsdf").read_bytes()[:5000])
    status, out, err = run("import", ".", cwd=tmp_path)
    assert status == 1
    assert "imported  1" in out
    assert "broken_rgb.bsdf" in one_line(err)


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
    process = start("report", cwd=folder)
    process.stdout.readline()
    process.stdout.close()
    process.wait(timeout=120)
    assert "Traceback" not in process.stderr.read()


def test_an_interruption_leaves_nothing_half_written(tmp_path):
    process = start("corpus", "out", cwd=tmp_path)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("out/*_spec.bsdf")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in one_line(err)
    files = sorted((tmp_path / "out").iterdir())
    assert files
    for path in files:
        read_bsdf(path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_one_error(run, tmp_path):
    tmp_path.chmod(0o555)
    status, _, err = run("corpus", "out", cwd=tmp_path)
    assert status == 1
    assert "cannot make this folder" in one_line(err)


def test_the_package_installs_no_global_module_named_cli(tmp_path):
    code = "import importlib.util, manifold.cli.main; print(importlib.util.find_spec('cli'))"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert out.stdout.strip() == "None"


def test_every_module_has_its_place_in_the_layers():
    """A module that the contracts do not name is a module they do not check."""
    contracts = (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")
    modules = {path.stem for path in Path(REPOSITORY, "manifold").glob("*.py")} - {"__init__"}
    assert {m for m in modules if f"manifold.{m}" not in contracts} == set()
