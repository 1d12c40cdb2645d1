"""Packages that add formats, targets and methods: listed, used, and harmless when they are broken."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from helpers.one_process import run_together, with_packages
from helpers.paths import REPOSITORY
from helpers.small_library import small_model

from manifold.fit.exports.targets import Target
from manifold.registries import TARGETS as TARGETS_OF_PACKAGES

READER = """
import numpy as np
from manifold.core.directions import from_spherical
from manifold.formats import Readings


def sniff(head):
    return head.startswith(b"LAB LOG")


def read(path):
    rows = np.loadtxt(path, skiprows=1)
    wi = from_spherical(np.deg2rad(rows[:, 0]), np.pi)
    wo = from_spherical(np.deg2rad(rows[:, 1]), 0.0)
    return [Readings(path.stem, "lab log", wi, wo, np.array([465.0, 525.0, 630.0]), rows[:, 2:])]
"""
TARGET = """
import json
from dataclasses import replace
from manifold.fit.exports import TARGETS


def content(export):
    return json.dumps({"shader": "standard", **export.parameters}).encode()


STUDIO = replace(TARGETS["gltf"], name="studio", suffix=".studio", title="Studio", content=content)
"""
METHOD = """
import numpy as np


def shake(run, X):
    rng = np.random.default_rng(0)
    for _ in range(min(run.max_iter, 5)):
        candidate = run.best_X + 1e-3 * rng.standard_normal(X.shape)
        run.report(candidate, run.objective(candidate)[0])
"""
LOG = "LAB LOG\n45 0 0.10 0.12 0.20\n45 30 0.14 0.15 0.24\n"


def install(folder, package, module, code, *entries):
    """Install a package of one module into a folder, as pip would."""
    (folder / f"{module}.py").write_text(code)
    info = folder / f"{package.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    groups = "".join(f"[brdf_manifold.{group}]\n{name} = {value}\n" for group, name, value in entries)
    (info / "entry_points.txt").write_text(groups)


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """A folder with a package for each group."""
    folder = tmp_path_factory.mktemp("packages")
    install(folder, "lab-formats", "lab_reader", READER, ("formats", "lab log", "lab_reader"))
    install(folder, "lab-studio", "lab_target", TARGET, ("targets", "studio", "lab_target:STUDIO"))
    install(folder, "lab-search", "lab_method", METHOD, ("methods", "shake", "lab_method:shake"))
    return folder


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    folder = tmp_path_factory.mktemp("work")
    (folder / "sample.log").write_text(LOG)
    (folder / "plain.csv").write_text("theta_i,theta_o,465 nm,525 nm,630 nm\n45,0,0.10,0.12,0.20\n")
    small_model(folder)
    return folder


def run(work, packages, *words):
    """Run the command line with a folder of packages; what it printed."""
    return subprocess.run(
        [sys.executable, "-m", "manifold", *words],
        cwd=work, capture_output=True, text=True, check=False, env=with_packages(packages),
    )  # fmt: skip


COMMANDS = {
    "help of info": ["info", "--help"],
    "help of convert": ["convert", "--help"],
    "help of export": ["export", "--help"],
    "help of embed": ["embed", "--help"],
    "info": ["info", "sample.log"],
    "convert": ["convert", "sample.log", "-o", "sample.csv"],
    "embed": ["embed", "--kind", "gplvm", "--optimizer", "shake", "-M", "shaken.h5"],
    "info of the model": ["info", "shaken.h5"],
}
TARGETS = """
from pathlib import Path
from manifold.fit.exports.targets import target_of
from manifold.registries import TARGETS

names = target_of(None, Path("x.studio")).title, target_of(None, Path("x.glb")).name, list(TARGETS)[-1]
print(json.dumps(names))
"""


@pytest.fixture(scope="module")
def outcomes(work, packages):
    """Status, stdout and stderr of the commands, and the names of targets."""
    return run_together([], COMMANDS, work, last=TARGETS, installed=packages)


@pytest.mark.parametrize(
    ("command", "name"),
    [("info", "lab log"), ("convert", "lab log"), ("export", "studio"), ("embed", "shake")],
)
def test_helps_list_entries_of_other_packages(command, name, outcomes):
    _, out, err = outcomes[f"help of {command}"]
    assert name in " ".join(out.split())
    assert err == ""


def test_a_reader_of_another_package_reads_its_files(work, outcomes):
    _, shown, _ = outcomes["info"]
    assert "sample.log: lab log" in shown
    assert "readings" in shown
    status, _, err = outcomes["convert"]
    assert status == 0, err
    assert "0.24" in (work / "sample.csv").read_text()


def test_a_target_of_another_package_is_exported_to(outcomes):
    assert outcomes["last"] == ["Studio", "gltf", "studio"]


def test_a_method_of_another_package_embeds(work, outcomes):
    status, _, err = outcomes["embed"]
    assert status == 0, err
    assert "shake" in outcomes["info of the model"][1]
    without = run(work, work, "info", "shaken.h5")
    assert without.returncode == 1
    assert "optimizer 'shake', expected dls or l-bfgs" in without.stderr


@pytest.fixture(scope="module")
def lab_kernels(tmp_path_factory):
    """The folder of packages that the example of the documentation installs, as it is printed there."""
    page = (REPOSITORY / "docs/how-to/extend.md").read_text(encoding="utf-8")
    cells = re.findall(r"^```\{code-cell\} python3\n%%bash\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    (cell,) = [cell for cell in cells if "pip install" in cell]
    folder = tmp_path_factory.mktemp("lab")
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    subprocess.run(
        ["bash", "-e"], input=cell, text=True, check=True, cwd=folder, env=os.environ | {"PATH": path}
    )
    return folder / "packages"


@pytest.mark.skipif(sys.platform == "win32", reason="cells of commands are for bash")
def test_a_kernel_and_a_mapping_of_another_package_embed_and_predict(work, lab_kernels):
    own = ("--kernel", "rational-quadratic", "--mapping", "fourth-root")
    made = run_together(
        [],
        {
            "embed": ["embed", "--kind", "gplvm", *own, "-M", "own.h5"],
            "info": ["info", "own.h5"],
            "predict": ["predict", "0.3,0.2", "-M", "own.h5", "-o", "own.bsdf"],
        },
        work,
        installed=lab_kernels,
    )
    assert [status for status, _, _ in made.values()] == [0, 0, 0], made
    assert "rational-quadratic" in made["info"][1]
    assert "fourth-root" in made["info"][1]
    assert (work / "own.bsdf").exists()
    without = run(work, work, "predict", "0.3,0.2", "-M", "own.h5", "-o", "lost.bsdf")
    assert without.returncode == 1
    assert "no kernel is called 'rational-quadratic'" in without.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="cells of commands are for bash")
def test_the_kernel_and_the_mapping_of_the_documentation_are_right(lab_kernels):
    script = """
import numpy as np
from manifold.gp.kernels import kernel_named
from manifold.registries import MAPPINGS

kernel, T = kernel_named("rational-quadratic"), MAPPINGS["fourth-root"]
r = np.linspace(0.0, 5.0, 100_001)
g, slope = kernel.radial(r * r)
np.testing.assert_allclose(np.gradient(g, r)[1:-1], (2.0 * r * slope)[1:-1], atol=1e-8)  # of second order in 5e-5
assert abs(np.abs(2.0 * r * slope).max() / kernel.steepest - 1.0) < 1e-8
f = np.geomspace(1e-4, 1e4, 9)
np.testing.assert_allclose(T.inverse(T.forward(f)), f, rtol=1e-14)
t, h = T.forward(f), 1e-6 * T.forward(f)
np.testing.assert_allclose((T.inverse(t + h) - T.inverse(t - h)) / (2.0 * h), T.slope(f), rtol=1e-9)
"""
    env = with_packages(lab_kernels)
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, env=env
    )
    assert done.returncode == 0, done.stderr


BROKEN = {
    "import no_such_module": "ModuleNotFoundError: No module named 'no_such_module'",
    "raise SystemExit('no')": "SystemExit: no",
    "def sniff(head): return True": "AttributeError: broken2 has no read",
    "def sniff(head): return head[99999]\ndef read(path): return []": "IndexError",
    "def sniff(head): raise SystemExit('no')\ndef read(path): return []": "SystemExit: no",
    "import numpy\ndef sniff(head): return numpy.ones(2)\ndef read(path): return []": "sniff returned ndarray",
    "def sniff(head): return 'no'\ndef read(path): return []": "sniff returned str, expected bool",
}
"""Readers of broken packages, and what is said of them."""


def test_broken_packages_are_named_in_a_line_each_and_stop_no_other(work, packages, tmp_path):
    for k, code in enumerate(BROKEN):
        install(
            tmp_path, f"broken-formats{k}", f"broken{k}", code, ("formats", f"broken log{k}", f"broken{k}")
        )
    both = f"{packages}{os.pathsep}{tmp_path}"
    listed = " ".join(run(work, both, "info", "--help").stdout.split())
    for name, format_name in (("sample.log", "lab log"), ("plain.csv", "CSV table")):
        done = run(work, both, "info", name)
        assert f"{name}: {format_name}" in done.stdout
        lines = sorted(done.stderr.splitlines())
        for k, (line, reason) in enumerate(zip(lines, BROKEN.values(), strict=True)):
            assert f"broken log{k}" in listed
            assert line.startswith(
                f"manifold: warning: the format 'broken log{k}' of the package broken-formats{k} is left out"
            )
            assert reason in line


@pytest.mark.parametrize(
    ("statement", "reason"),
    [
        ("return {}['x']", "KeyError: 'x'"),
        ("raise OSError('disk')", "OSError: disk"),
        ("raise SystemExit(0)", "SystemExit: 0"),
    ],
)
def test_a_reader_that_fails_is_named(work, tmp_path, statement, reason):
    code = f"def sniff(head): return head.startswith(b'LAB')\ndef read(path): {statement}"
    install(tmp_path, "broken-formats", "broken", code, ("formats", "broken log", "broken"))
    done = run(work, tmp_path, "info", "sample.log")
    assert done.returncode == 1
    assert done.stderr == (
        f"manifold: sample.log: the reader of broken log in the package broken-formats failed ({reason})\n"
    )


@pytest.mark.parametrize(
    "statement", ["raise ValueError('no')", "raise SystemExit(0)", "raise OSError('no')"]
)
def test_a_method_that_fails_is_named(work, tmp_path, statement):
    code = f"def search(run, X): {statement}"
    install(tmp_path, "broken-methods", "broken", code, ("methods", "broken", "broken:search"))
    done = run(work, tmp_path, "embed", "--kind", "gplvm", "--optimizer", "broken", "-M", "never.h5")
    assert done.returncode == 1
    assert "the package broken-methods failed (" in done.stderr
    assert "internal error" not in done.stderr


def test_a_target_without_all_attributes_is_left_out(work, tmp_path):
    code = (
        "class TARGET: name, suffix, title, entries, parameters, brdf, content = 't', '.t', 't', {}, 0, 0, 0"
    )
    install(tmp_path, "broken-targets", "broken", code, ("targets", "broken", "broken:TARGET"))
    done = run(work, tmp_path, "export", "plain.csv", "-o", "x.t")
    assert done.returncode == 2
    assert "the target 'broken' of the package broken-targets is left out" in done.stderr
    assert "has no base_colour, coat, sheen" in done.stderr
    assert "internal error" not in done.stderr


def test_a_target_must_have_what_a_target_has():
    named = set(TARGETS_OF_PACKAGES._attributes)
    assert named == {field.name for field in fields(Target)} | {"brdfs", "defaults"}


def test_an_entry_named_as_a_built_in_one_is_left_out(work, tmp_path):
    install(tmp_path, "other-merl", "other", READER, ("formats", "MERL", "other"))
    done = run(work, tmp_path, "info", "plain.csv")
    assert "CSV table" in done.stdout
    assert (
        "the format 'MERL' of the package other-merl is left out (another entry has this name)" in done.stderr
    )


@pytest.mark.parametrize(
    ("group", "code", "words"),
    [
        ("kernels", "class ENTRY: family, steepest, radial = 'k', 1.0, 0", "has no training, gradient"),
        ("methods", "ENTRY = 5", "has no __call__"),
    ],
)
def test_an_entry_that_cannot_be_used_is_left_out(work, tmp_path, group, code, words):
    install(tmp_path, "broken-entries", "broken", code, (group, "broken", "broken:ENTRY"))
    option = {"kernels": "--kernel", "methods": "--optimizer"}[group]
    done = run(work, tmp_path, "embed", "--kind", "gplvm", option, "broken", "-M", "never.h5")
    assert done.returncode == 2
    assert words in done.stderr
    assert "internal error" not in done.stderr
