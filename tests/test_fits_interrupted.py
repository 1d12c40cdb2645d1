"""Fits in several processes: Ctrl-C, a process that is killed, a parent that is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_library import measured
from typer.testing import CliRunner

from manifold.cli.main import app
from manifold.fitting.processes import in_processes
from manifold.io_rgl import write_bsdf
from manifold.workflows import fits

PATIENCE_S = 120  # after which a test fails; nothing waits that long where all is well

# Every process interrupts itself while it starts, says that it is there, and would go on for ever.
WAITING = """
import os, signal, sys, time
from pathlib import Path
from manifold.fitting.processes import in_processes

if __name__ == "__mp_main__":
    os.kill(os.getpid(), signal.SIGINT)

def wait(folder):
    mark = Path(folder, f"{os.getpid()}.tmp")
    mark.touch()
    mark.rename(mark.with_suffix(".pid"))
    while True:
        time.sleep(0.1)

if __name__ == "__main__":
    try:
        list(in_processes(wait, [(sys.argv[1],)] * 3, 2))
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.fixture
def waiting(tmp_path):
    """A program of two processes at work, in a process group of its own, and the two."""
    script = tmp_path / "waiting.py"
    script.write_text(WAITING)
    program = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    deadline = time.monotonic() + PATIENCE_S
    while len(found := list(tmp_path.glob("*.pid"))) < 2:
        assert program.poll() is None, program.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    yield program, [int(path.stem) for path in found]
    program.kill()
    for path in tmp_path.glob("*.pid"):
        if is_running(int(path.stem)):
            os.kill(int(path.stem), signal.SIGKILL)


def is_running(pid: int) -> bool:
    """Whether a process is there and more than an entry that nobody has asked for yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_ctrl_c_is_answered_by_the_parent_alone_and_ends_all_processes(waiting):
    program, processes = waiting
    os.killpg(program.pid, signal.SIGINT)  # as a terminal does
    out, err = program.communicate(timeout=PATIENCE_S)
    assert (out, err) == ("interrupted\n", "")
    assert not any(map(is_running, processes))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_no_process_outlives_a_parent_that_is_killed(waiting):
    program, processes = waiting
    program.kill()
    program.wait(timeout=PATIENCE_S)
    deadline = time.monotonic() + PATIENCE_S
    while any(map(is_running, processes)):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def square_or_die(x: int) -> int:
    """The square; 0 is killed."""
    if x == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return x * x


def test_what_was_finished_before_a_process_was_killed_is_returned():
    assert list(in_processes(square_or_die, [(1,), (2,), (0,), (3,)], 1)) == [1, 4]


def test_an_error_of_the_function_is_raised_and_leaves_no_process():
    with pytest.raises(TypeError):
        list(in_processes(square_or_die, [("x",)], 1))


def test_after_a_killed_process_the_finished_fits_are_reported_and_the_rest_named_once(tmp_path, monkeypatch):
    folder = tmp_path / "files"
    for name in ("a", "b", "c"):
        (folder / name).mkdir(parents=True)
        write_bsdf(folder / name / f"{name}_rgb.bsdf", measured("syn_felt_green"))

    def first_only(function, calls, n, initializer):
        yield function(*calls[0])

    monkeypatch.setattr(fits, "in_processes", first_only)
    target = tmp_path / "all.json"
    words = ["fit", str(folder), "-o", str(tmp_path / "out"), "-j", "2", "--free", "base_color"]
    result = CliRunner().invoke(app, [*words, "--json", str(target)])
    assert str(result.exception).startswith("b, c: not fitted, since a process was killed (out of memory?)")
    assert str(result.exception).count("killed") == 1
    assert "a.fit.json" in result.stdout
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.fit.json"]
    content = json.loads(target.read_text())
    assert [fit["source"]["name"] for fit in content["fits"]] == ["a"]
    assert [line.split(":")[0] for line in content["failed"]] == ["b", "c"]
