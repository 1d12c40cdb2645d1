"""Threads that meet in parallel kernels and in BLAS."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers.paths import REPOSITORY
from helpers.sample_files import sample_file
from threadpoolctl import threadpool_info

from manifold.brdf.measured import MeasuredBRDF
from manifold.core import threads
from manifold.core.compiled import loops
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.threads import (
    VARIABLE,
    limit_threads,
    one_blas_thread,
    share_out,
    share_rows,
    thread_count,
)

AFTER_A_FORK = """
import os, sys
import numpy as np
from helpers.sample_files import sample_file
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.directions import from_spherical
brdf = MeasuredBRDF(sample_file("m", 0, size=24))
wi = from_spherical(np.linspace(0.1, 1.4, 4000), np.zeros(4000))  # several blocks
before = brdf.eval(wi, wi)
child = os.fork()
equal = np.array_equal(brdf.eval(wi, wi), before)
if child == 0:
    os._exit(0 if equal else 1)
sys.exit(not equal or os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_fork_of_a_process_with_threads_evaluates():
    environment = os.environ | {VARIABLE: "3", "PYTHONPATH": str(REPOSITORY / "tests")}
    child = subprocess.run(
        [sys.executable, "-c", AFTER_A_FORK],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,  # threads that do not exist would be waited for
    )
    assert child.returncode == 0, child.stderr[-500:]


def test_ten_threads_evaluate_at_the_same_time_what_one_does(rng):
    materials = [MeasuredBRDF(sample_file(f"m{k}", k, size=24)) for k in range(4)]
    wi, wo = (from_spherical(rng.uniform(0.0, 1.5, 3000), rng.uniform(-np.pi, np.pi, 3000)) for _ in range(2))
    expected = [material.eval(wi, wo) for material in materials]
    with limit_threads(3), ThreadPoolExecutor(10) as pool:
        values = list(pool.map(lambda material: material.eval(wi, wo), 5 * materials))
    for k, value in enumerate(values):
        np.testing.assert_array_equal(value, expected[k % len(expected)])


def test_work_is_shared_out_once_and_stays_on_its_thread_within():
    rows, threads_of_parts = [], []

    def part(k: int) -> None:
        own = threading.get_ident()
        share_rows(lambda block: rows.append((k, block.start, threading.get_ident() == own)), 8, 2)
        threads_of_parts.append(own)

    with limit_threads(3):
        share_out(part, range(20))
    assert sorted(rows) == [(k, start, True) for k in range(20) for start in (0, 2, 4, 6)]
    assert len(set(threads_of_parts)) <= 3


def test_an_error_in_a_part_is_raised_and_ends_the_others():
    done = []

    def part(k: int) -> None:
        if k == 3:
            raise ValueError("part 3")
        done.append(k)

    with limit_threads(2), pytest.raises(ValueError, match="part 3"):
        share_out(part, range(10_000))
    assert len(done) < 9_999
    with limit_threads(2):
        share_out(done.append, [10_001])  # threads are there as before
    assert done[-1] == 10_001


@pytest.mark.parametrize("text", ["0", "two", "-1", "1.5"])
def test_an_invalid_number_of_threads_is_refused(monkeypatch, text):
    monkeypatch.setenv(VARIABLE, text)
    with pytest.raises(UsageError, match=rf"{VARIABLE} is '{text}', expected a number of threads"):
        thread_count()


def test_arrays_of_other_shapes_and_types_are_refused_before_a_loop_runs():
    """No size, index or type that a loop is given can end the process."""
    points, out = np.zeros((4, 2)), np.zeros(4)
    with pytest.raises(ValueError, match="expected a table of at least 2 x 2 nodes"):
        loops.interpolate(np.zeros((1, 5)), points, out)
    with pytest.raises(ValueError, match="room for"):
        loops.interpolate(np.zeros((3, 5)), points, out[:3])
    with pytest.raises(TypeError):
        loops.interpolate(np.zeros((3, 5)), points, np.zeros(4, np.float32))
    with pytest.raises(TypeError):
        loops.interpolate(np.zeros(5), points, out)
    wild = np.array([[np.nan, np.inf], [-np.inf, 2.0], [1e300, -1e300], [0.5, np.nan]])
    loops.interpolate(np.ones((3, 5)), wild, out)  # indices are clamped
    assert out[1] == 1.0


def test_overlapping_users_limit_blas_once_and_the_last_one_gives_it_back(monkeypatch):
    done = []

    class Limits:
        def limit(self, limits: int, user_api: str) -> Limits:
            done.append((limits, user_api))
            return self

        def restore_original_limits(self) -> None:
            done.append("restored")

    monkeypatch.setattr(threads, "_blas", Limits)
    inside, may_leave = threading.Event(), threading.Event()

    def outer() -> None:
        with one_blas_thread:
            inside.set()
            may_leave.wait(30)

    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(outer)
        inside.wait(30)
        with one_blas_thread:  # entered while the other is inside, left after it
            may_leave.set()
            running.result()
            assert done == [(1, "blas")]
    assert done == [(1, "blas"), "restored"]


def test_blas_keeps_to_one_thread_and_has_them_back():
    before = blas_threads()
    with one_blas_thread, one_blas_thread:
        assert blas_threads() == {1}
    assert blas_threads() == before
    assert one_blas_thread(blas_threads)() == {1}  # as a decorator
    assert blas_threads() == before
