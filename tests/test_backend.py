"""Choosing how Mitsuba runs: libraries that work, abort, hang, are too old or missing."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from small_library import measured

from manifold.errors import UsageError
from manifold.io_rgl import write_bsdf
from manifold.rendering import backend, libllvm

PROGRAM = [sys.executable, "-c", "from manifold.cli.main import run; run()"]


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Answers remembered in a folder of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(backend.RENDERER_VARIABLE, raising=False)
    monkeypatch.delenv(libllvm.LIBRARY_VARIABLE, raising=False)


def library_file(folder: Path, version: int) -> Path:
    """A file that is called like a library."""
    path = folder / f"libLLVM-{version}.so"
    path.write_bytes(b"no library")
    return path


def test_the_first_library_that_works_is_chosen_and_later_ones_are_not_tried(tmp_path):
    new, old = library_file(tmp_path, 19), library_file(tmp_path, 15)
    tried = []

    def attempt(path):
        tried.append(path)
        return libllvm.WORKS

    chosen = backend.choose_among([new, old], attempt)
    assert chosen.is_llvm
    assert chosen.library == new
    assert chosen.advice is None
    assert tried == [new]


def test_without_a_library_that_works_the_advice_is_one_line_that_names_them(tmp_path):
    outcomes = {15: "kills the process (SIGABRT)", 14: "is too old (version 14)"}
    paths = {library_file(tmp_path, version): outcome for version, outcome in outcomes.items()}
    chosen = backend.choose_among(list(paths), paths.__getitem__)
    assert chosen.kind == "scalar"
    assert "\n" not in chosen.advice
    for expected in ("libLLVM-15.so kills the process", "libLLVM-14.so is too old", "install"):
        assert expected in chosen.advice
    assert "no libLLVM" in backend.choose_among([], libllvm.probe).advice


def test_answers_are_remembered_until_the_file_changes(tmp_path):
    path = library_file(tmp_path, 18)
    assert backend.choose_among([path], lambda _: "fails").probes[0] == libllvm.Probe(path, "fails")
    again = backend.choose_among([path], lambda _: pytest.fail("tried again"))
    assert again.probes[0] == libllvm.Probe(path, "fails", remembered=True)
    assert backend.choose_among([path], lambda _: libllvm.WORKS, refresh=True).is_llvm
    path.write_bytes(b"another library")
    assert backend.choose_among([path], lambda _: "fails again").probes[0].outcome == "fails again"


@pytest.mark.parametrize(
    "outcome",
    ["does not answer within 60 s", "cannot be tried (Cannot allocate memory)", "is stopped from outside"],
)
def test_what_tells_of_a_busy_machine_is_tried_again(tmp_path, outcome):
    path = library_file(tmp_path, 18)
    assert backend.choose_among([path], lambda _: outcome).kind == "scalar"
    assert backend.choose_among([path], lambda _: libllvm.WORKS).is_llvm


def test_a_cache_that_cannot_be_used_is_no_error(tmp_path, monkeypatch):
    path = library_file(tmp_path, 18)
    backend.choose_among([path], lambda _: "fails")
    libllvm.cache_path().write_text("{ no json")
    assert backend.choose_among([path], lambda _: libllvm.WORKS).is_llvm
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(in_the_way))
    assert backend.choose_among([path], lambda _: libllvm.WORKS).is_llvm


def test_the_environment_variable_forces_a_backend(tmp_path, monkeypatch):
    path = library_file(tmp_path, 18)
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "scalar")
    chosen = backend.choose_among([path], lambda _: pytest.fail("tried"))
    assert (chosen.kind, chosen.advice) == ("scalar", None)
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "llvm")
    with pytest.raises(UsageError, match=r"MANIFOLD_RENDERER is llvm, but found libLLVM-18\.so fails"):
        backend.choose_among([path], lambda _: "fails")
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "cuda")
    with pytest.raises(UsageError, match="expected auto, llvm or scalar"):
        backend.choose_among([path], lambda _: libllvm.WORKS)


def test_a_file_that_is_no_library_fails_the_probe_without_harm(tmp_path):
    assert libllvm.probe(library_file(tmp_path, 18)).startswith("fails")
    assert libllvm.probe(tmp_path / "libLLVM-1.so") == "is no file"


def python_that(folder: Path, code: str) -> str:
    """An interpreter that does something else than it is asked to."""
    path = folder / "python"
    path.write_text(f"#!{PROGRAM[0]}\n{code}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_a_child_that_aborts_or_hangs_is_an_answer(tmp_path, monkeypatch):
    library = library_file(tmp_path, 18)
    monkeypatch.setattr(sys, "executable", python_that(tmp_path, "import os; os.abort()"))
    assert libllvm.probe(library) == "kills the process (SIGABRT)"
    monkeypatch.setattr(sys, "executable", python_that(tmp_path, "import time; time.sleep(60)"))
    assert libllvm.probe(library, timeout_s=0.5) == "does not answer within 0.5 s"
    kill = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    monkeypatch.setattr(sys, "executable", python_that(tmp_path, kill))
    assert libllvm.probe(library).startswith("is stopped from outside")


def test_newer_libraries_come_first_and_a_named_one_before_all(tmp_path, monkeypatch):
    monkeypatch.setattr(libllvm, "_known_to_the_linker", lambda: [library_file(tmp_path, v) for v in (9, 19)])
    monkeypatch.setattr(libllvm, "_in_folders", lambda: [library_file(tmp_path, v) for v in (15, 19)])
    monkeypatch.setattr(libllvm, "_in_packages", list)
    assert [p.name for p in libllvm.find_libraries()] == [f"libLLVM-{v}.so" for v in (19, 15, 9)]
    monkeypatch.setenv(libllvm.LIBRARY_VARIABLE, str(tmp_path / "libLLVM-15.so"))
    assert [p.name for p in libllvm.find_libraries()] == [f"libLLVM-{v}.so" for v in (15, 19, 9)]


CHILDREN = {
    "kills the process (SIGABRT)": "import os; os.abort()",
    "is too old (version 14)": "raise SystemExit('the located LLVM version (14) is too old.')",
    "no libLLVM": "",
}


@pytest.mark.parametrize(
    ("outcome", "libraries"),
    [
        ("kills the process (SIGABRT)", 1),
        pytest.param("is too old (version 14)", 1, marks=pytest.mark.slow),
        ("no libLLVM", 0),
    ],
)
def test_render_finishes_with_a_picture_and_one_line_of_advice_without_llvm(tmp_path, outcome, libraries):
    """What users of machines with a libLLVM that aborts, is too old or is missing see."""
    write_bsdf(tmp_path / "red_rgb.bsdf", measured("syn_gloss_red"))
    paths = [str(library_file(tmp_path, 15))] * libraries
    child = CHILDREN[outcome]
    script = (
        "import sys; from pathlib import Path; from manifold.rendering import libllvm\n"
        f"libllvm.find_libraries = lambda: [Path(p) for p in {paths!r}]\n"
        f"sys.executable = {python_that(tmp_path, child)!r}\n"
        "from manifold.cli.main import run; run()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, "render", "red_rgb.bsdf", "-o", "red.png", "--size", "24", "--samples", "4"],
        cwd=tmp_path, capture_output=True, text=True, env=dict(os.environ), check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "red.png").stat().st_size > 500
    advice = [line for line in done.stderr.splitlines() if line.strip()]
    assert len(advice) == 1
    assert outcome in advice[0]
    assert "install" in advice[0]


def loaded_with_a_wrong_library(first: str) -> subprocess.CompletedProcess[str]:
    """A process whose environment names no libLLVM, which does something first and then renders."""
    script = f"from manifold.rendering import backend\n{first}\nprint(backend.mitsuba('rgb').variant())"
    wrong = os.environ | {libllvm.LIBRARY_VARIABLE: "/nonexist"}
    return subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=wrong, check=False
    )


@pytest.mark.skipif(not backend.choose().is_llvm, reason="no libLLVM works on this machine")
def test_a_named_library_that_is_none_gives_way_to_one_that_works():
    done = loaded_with_a_wrong_library("backend.is_available()")
    assert (done.stdout, done.stderr) == ("llvm_ad_rgb\n", "")


@pytest.mark.skipif(not backend.choose().is_llvm, reason="no libLLVM works on this machine")
def test_dr_jit_that_somebody_imported_with_a_wrong_library_is_one_clear_error():
    done = loaded_with_a_wrong_library("import drjit")
    assert done.stderr.splitlines()[-1].startswith(
        "manifold.errors.RendererError: Dr.Jit was imported while DRJIT_LIBLLVM_PATH named no libLLVM that works"
    )


def test_info_tells_the_renderer_and_why(tmp_path):
    done = subprocess.run(
        [*PROGRAM, "info", "--renderer", "--json", "-"],
        capture_output=True, text=True, env=os.environ | {backend.RENDERER_VARIABLE: "scalar"}, check=True,
    )  # fmt: skip
    document = json.loads(done.stdout)
    assert document["kind"] == "scalar"
    assert document["mitsuba"] == libllvm.mitsuba_version()
    assert all("not tested" in outcome for outcome in document["libraries"].values())


def test_kinds_of_colour_that_do_not_exist_are_refused():
    with pytest.raises(UsageError, match="expected spectral, rgb, mono"):
        backend.mitsuba("cmyk")


def test_dr_jit_has_one_thread_while_processor_times_are_measured():
    dr = backend.drjit()
    before = dr.thread_count()
    dr.set_thread_count(3)
    try:
        with backend.one_thread():
            assert dr.thread_count() < 3
        assert dr.thread_count() == 3
    finally:
        dr.set_thread_count(before)


def test_an_interrupted_import_of_mitsuba_is_not_a_missing_one(monkeypatch):
    class Interrupted:
        def find_spec(self, name, path, target=None):
            if name == "mitsuba":
                raise ImportError("half of it is loaded") from KeyboardInterrupt()

    monkeypatch.delitem(sys.modules, "mitsuba", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted()])
    with pytest.raises(KeyboardInterrupt):
        backend.is_available()
