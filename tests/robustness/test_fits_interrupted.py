"""Fits in several processes: Ctrl-C, and a process that is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from helpers.small_library import measured

from manifold.core import work
from manifold.core.errors import ManifoldError
from manifold.estimate.inputs import find_inputs
from manifold.estimate.sources import FileSource
from manifold.fit import fits
from manifold.fit.fits import FitSettings
from manifold.io_rgl import write_bsdf
from manifold.many.batch import batch

pytestmark = pytest.mark.slow


@pytest.fixture
def folder(tmp_path):
    """A folder `files` of eight materials."""
    (tmp_path / "files").mkdir()
    for k in range(8):
        write_bsdf(tmp_path / "files" / f"felt_{k}_rgb.bsdf", measured("syn_felt_green"))
    return tmp_path


def test_ctrl_c_ends_all_processes_and_keeps_finished_fits(folder):
    out = folder / "out"
    words = ["fit", str(folder / "files"), "-o", str(out), "-j", "2"]
    program = subprocess.Popen(
        [sys.executable, "-m", "manifold", *words], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    end = time.monotonic() + 120.0
    while not list(out.glob("*.fit.json")) and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(program.pid, signal.SIGINT)  # as a terminal does
    _, complained = program.communicate(timeout=120)
    assert program.returncode == 130
    assert "Traceback" not in complained
    noted = [json.loads(line)["file"] for line in (out / "fits.jsonl").read_text().splitlines()]
    assert {path.name for path in out.glob("*.fit.json")} == set(noted)


def killed(source, target, *, settings, with_pictures):
    """A fit whose process is killed, as where memory is short."""
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_process_is_one_error(folder, monkeypatch):
    monkeypatch.setattr(fits, "_fit_input", killed)
    command, inputs = fits.fits(FitSettings()), find_inputs([FileSource(folder / "files")])
    with (
        work.processes(2) as workers,
        pytest.raises(ManifoldError, match=r"a worker process was killed .*finished files are kept"),
    ):
        batch(command, inputs, folder / "out", workers)
