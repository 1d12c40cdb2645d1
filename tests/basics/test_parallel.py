"""Threads that meet in parallel kernels and in BLAS."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

from helpers.paths import REPOSITORY
from threadpoolctl import threadpool_info

from manifold import threads
from manifold.threads import one_blas_thread, serialised

EVALUATED_IN_THREADS = """
from concurrent.futures import ThreadPoolExecutor
import numba
import numpy as np
from helpers.sample_files import sample_file
from manifold.brdf.measured import MeasuredBRDF
from manifold.directions import from_spherical
brdfs = [MeasuredBRDF(sample_file(f"m{k}", k, size=24)) for k in range(8)]
wi = from_spherical(np.linspace(0.1, 1.4, 2000), np.zeros(2000))  # fewer are evaluated in one thread
with ThreadPoolExecutor(4) as pool:
    for _ in range(5):
        list(pool.map(lambda brdf: brdf.eval(wi, wi), brdfs))
assert numba.threading_layer() == "workqueue", numba.threading_layer()
"""


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_threads_enter_parallel_kernels_where_neither_openmp_nor_tbb_is_installed():
    """There, Numba ends the process when two threads are in its pool."""
    environment = os.environ | {
        "NUMBA_THREADING_LAYER": "workqueue",
        "NUMBA_NUM_THREADS": "2",
        "PYTHONPATH": str(REPOSITORY / "tests"),
    }
    child = subprocess.run(
        [sys.executable, "-c", EVALUATED_IN_THREADS],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 0, child.stderr[-500:]


def test_one_thread_at_a_time_is_in_a_kernel_of_its_kind():
    inside, most = [], []
    barrier = threading.Barrier(4, timeout=30)

    @serialised
    def kernel() -> None:
        inside.append(1)
        most.append(len(inside))
        threading.Event().wait(0.01)
        inside.pop()

    def enter() -> None:
        barrier.wait()
        kernel()

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(enter) for _ in range(4)]:
            done.result()
    assert most == [1, 1, 1, 1]


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
