"""The attack itself: it runs, and it tells when something is silently wrong."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys

import pytest
from attack import sandbox
from attack.mutations import of_bytes, of_text
from helpers.paths import REPOSITORY


def test_the_sandbox_reports_crashes_exceptions_and_memory(tmp_path):
    def crash() -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def fail() -> None:
        raise KeyError("x")

    def grow() -> None:
        assert bytearray(5 << 30)

    for task, words in ((crash, "crash: SIGKILL"), (fail, "traceback: KeyError"), (grow, "MemoryError")):
        problem = sandbox.run(task, tmp_path, tmp_path / "log").problem
        assert problem is not None
        assert words in problem
    assert sandbox.run(lambda: None, tmp_path, tmp_path / "log").problem is None


def test_mutations_are_those_of_their_seed():
    for change, original in ((of_bytes, bytes(range(256)) * 4), (of_text, "a scene of words " * 20)):
        made = [change(original, random.Random(k)) for k in range(50)]
        assert made == [change(original, random.Random(k)) for k in range(50)]
        assert sum(one != original for one in made) > 40


@pytest.mark.slow
def test_a_short_attack_finds_nothing():
    ended = subprocess.run(
        [sys.executable, "tools/attack", "--minutes", "0.3", "--flips", "500", "--kills", "10"],
        cwd=REPOSITORY, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
