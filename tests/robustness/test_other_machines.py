"""The tool that runs tests as processors of other core types compute."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

TESTS = """
import os
import threadpoolctl

def test_passes():
    assert os.environ["OPENBLAS_NUM_THREADS"] == "2"
    import scipy.linalg
    (kernels,) = {library["architecture"] for library in threadpoolctl.threadpool_info() if "architecture" in library}
    assert kernels not in ("Haswell", "SkylakeX")

def test_fails():
    assert False
"""


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="core types are those of x86-64")
def test_tests_run_with_the_kernels_of_another_core_type_and_failures_are_named(tmp_path):
    (tmp_path / "test_two.py").write_text(TESTS)
    options = ["--cores", "Prescott", "--threads", "2", "--seeds", "7", "--logs", tmp_path / "logs"]
    command = [sys.executable, "tools/other_machines.py", *options, "--", tmp_path / "test_two.py"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "Prescott, threads 2, seed 7: 1 failed, 1 passed" in done.stdout
    assert "FAILED " in done.stdout
    assert "::test_fails" in done.stdout
    assert "assert False" in (tmp_path / "logs" / "Prescott-2-7.log").read_text()
