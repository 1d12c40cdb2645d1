"""Choosing how Mitsuba runs: the newest libLLVM by its name, one that cannot be used, or none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.small_library import measured

from manifold.core.errors import UsageError
from manifold.io_rgl import write_bsdf
from manifold.render import backend
from manifold.render.images import read_image

PROGRAM = [sys.executable, "-c", "from manifold.cli.main import run; run()"]


@pytest.fixture
def choose(monkeypatch):
    """The choice, made anew."""
    monkeypatch.delenv(backend.RENDERER_VARIABLE, raising=False)
    monkeypatch.delenv(backend.LIBRARY_VARIABLE, raising=False)
    return backend.choose.__wrapped__


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (["libLLVM-15.so", "libLLVM-19.so", "libLLVM-18.so.1"], "libLLVM-19.so"),
        (["libLLVM.so.20.1", "libLLVM-19.so"], "libLLVM.so.20.1"),
        (["llvm-18/lib/libLLVM.so", "libLLVM-17.so.1"], "llvm-18/lib/libLLVM.so"),
        (["llvm/19.1.0/lib/libLLVM.dylib"], "llvm/19.1.0/lib/libLLVM.dylib"),
        (["libLLVM-14.0.6.so.1", "libLLVM-16.so", "libLLVMSupport-19.so", "libLLVM-19.a"], None),
        ([], None),
    ],
)
def test_the_newest_library_of_version_17_or_later_is_chosen(tmp_path, monkeypatch, choose, names, chosen):
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    folders = [str(tmp_path), *(str((tmp_path / name).parent) for name in names)]
    monkeypatch.setattr(backend, "_FOLDERS", folders)
    found = choose()
    if chosen is None:
        assert found.kind == "scalar"
        assert "install" in found.advice
        assert "\n" not in found.advice
    else:
        assert found == backend.Backend("llvm", tmp_path / chosen)


def test_environment_variables_force_a_backend_and_a_library(monkeypatch, choose):
    monkeypatch.setattr(backend, "_FOLDERS", ())
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "llvm")
    with pytest.raises(UsageError, match="there is no libLLVM; install"):
        choose()
    monkeypatch.setenv(backend.LIBRARY_VARIABLE, "/some/libLLVM-15.so")
    assert choose().library == Path("/some/libLLVM-15.so")
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "scalar")
    assert choose() == backend.Backend("scalar")
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "cuda")
    with pytest.raises(UsageError, match="expected auto, llvm or scalar"):
        choose()


def test_render_finishes_with_a_picture_and_one_line_of_advice_without_llvm(tmp_path):
    write_bsdf(tmp_path / "red_rgb.bsdf", measured("syn_gloss_red"))
    script = (
        "from manifold.render import backend\nbackend._FOLDERS = ()\nfrom manifold.cli.main import run; run()"
    )
    environment = {key: value for key, value in os.environ.items() if key != backend.LIBRARY_VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", script, "render", "red_rgb.bsdf", "-o", "red.png", "--size", "24", "--samples", "4"],
        cwd=tmp_path, capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "red.png").stat().st_size > 500
    (advice,) = [line for line in done.stderr.splitlines() if line.strip()]
    assert "install libLLVM 17 or newer" in advice


def test_a_named_library_that_cannot_be_used_is_one_clear_error(tmp_path):
    done = subprocess.run(
        [*PROGRAM, "info", "--system"], capture_output=True, text=True, check=False,
        env=os.environ | {backend.LIBRARY_VARIABLE: "/nonexist/libLLVM-19.so"},
    )  # fmt: skip
    assert done.returncode == 0
    assert "Dr.Jit cannot use /nonexist/libLLVM-19.so" in " ".join(done.stdout.split())


def test_info_tells_the_renderer(tmp_path):
    done = subprocess.run(
        [*PROGRAM, "info", "--system", "--json", "-"],
        capture_output=True, text=True, env=os.environ | {backend.RENDERER_VARIABLE: "scalar"}, check=True,
    )  # fmt: skip
    document = json.loads(done.stdout)
    assert document["renderer"]["kind"] == "scalar"
    assert document["extras"]["render"]["mitsuba"] == backend.mitsuba_version()


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


def test_open_exr_is_written_by_a_process_of_one_thread(tmp_path):
    # Mitsuba alone would wait for ever; so would a folder of surfaces, whose processes have one thread each.
    script = (
        "import sys; from pathlib import Path; import numpy as np; from manifold.render import backend, images\n"
        "backend.drjit().set_thread_count(0)\n"
        "images.write_image(Path(sys.argv[1]), np.ones((4, 4, 3)))\n"
        "assert backend.drjit().thread_count() < 2\n"
    )
    path = tmp_path / "x.exr"
    subprocess.run([sys.executable, "-c", script, str(path)], check=True, timeout=60)
    assert read_image(path).shape == (4, 4, 3)


def test_the_variant_is_set_again_once_where_blocks_that_keep_it_are_nested():
    mi = backend.mitsuba("rgb", backend.Backend("scalar"))
    with backend.variant_kept():
        with backend.variant_kept():
            backend.mitsuba("spectral", backend.Backend("scalar"))
        assert mi.variant() == "scalar_spectral"
    assert mi.variant() == "scalar_rgb"
