"""Local processes, threads and Dask run the same tasks to the same results."""

from __future__ import annotations

import gc
import json
import os
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from manifold.cli.batch_options import OneWorkerOptions, WorkerOptions
from manifold.core import cluster, work
from manifold.core.errors import ManifoldError, MissingPackageError, UsageError

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def local_cluster():
    """Two workers in processes of their own."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as made:
        yield made


@pytest.fixture
def threads_cluster():
    """One worker in a thread of this process."""
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=":0") as made:
        yield made


def squared(k):
    """A task that fails at 2 and 3, and sums at 5, which are others where BLAS has other numbers of threads."""
    if k == 2:
        raise ManifoldError("two is refused")
    if k == 3:
        raise FileNotFoundError(2, "No such file", "three.bsdf")
    if k == 5:
        a = np.random.default_rng(k).normal(size=(300, 3000))
        return (a @ a.T).tobytes()
    return k * k


def written(name):
    """The path of a file that was written in the current folder."""
    Path(name).write_text(str(os.getpid()))
    return str(Path(name).resolve())


def pid_of(_):
    return os.getpid()


def lost_once(marker):
    """A task whose worker ends the first time."""
    if not Path(marker).exists():
        Path(marker).touch()
        os._exit(9)
    return "done"


def results(function, tasks, workers=None):
    """Of each task its result, or why it failed."""
    return [
        value if failure is None else failure
        for _, value, failure in sorted(work.run(function, tasks, workers))
    ]


def there(address, function, tasks):
    """The same by the workers of a scheduler."""
    with cluster.workers(address) as workers:
        return results(function, tasks, workers)


def test_everyone_has_the_same_results_and_a_failure_stops_no_other(local_cluster):
    first = results(squared, range(6))
    assert first[:5] == [0, 1, "two is refused", "three.bsdf: No such file; check the path", 16]
    for executor in (
        work.processes(2),
        ThreadPoolExecutor(2),
        cluster.workers(local_cluster.scheduler_address),
    ):
        with executor as workers:
            assert results(squared, range(6), workers) == first


def test_relative_paths_mean_the_same_in_workers(local_cluster, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = there(local_cluster.scheduler_address, written, ["a", "b"])
    assert found == [str(tmp_path / "a"), str(tmp_path / "b")]
    assert str(os.getpid()) not in {(tmp_path / name).read_text() for name in "ab"}


def test_a_folder_that_workers_lack_is_one_line(local_cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster.os, "getcwd", lambda: str(tmp_path / "missing"))
    with pytest.raises(ManifoldError, match=r"cannot work in .*missing.*start in a folder"):
        there(local_cluster.scheduler_address, squared, [1])


def test_tasks_of_a_lost_worker_run_again(local_cluster, tmp_path):
    markers = [str(tmp_path / str(k)) for k in range(3)]
    assert there(local_cluster.scheduler_address, lost_once, markers) == ["done"] * 3


def test_a_worker_with_other_versions_is_one_line(threads_cluster, monkeypatch):
    answers = iter([{"numpy": "1.0"}, {"numpy": "2.0"}])
    monkeypatch.setattr(cluster, "versions", lambda: next(answers))
    with pytest.raises(ManifoldError, match=r"found numpy 2\.0, expected 1\.0; install the same"):
        there(threads_cluster.scheduler_address, squared, [1])


@contextmanager
def scheduler_alone(folder, **environment):
    """A scheduler without workers in a process of its own, and its address."""
    file = folder / "scheduler.json"
    words = ["dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file"]
    scheduler = subprocess.Popen(
        [sys.executable, "-m", *words, file], stderr=subprocess.DEVNULL, env=os.environ | environment
    )
    try:
        while not file.exists() or not file.read_text():
            assert scheduler.poll() is None
            time.sleep(0.05)
        yield scheduler, json.loads(file.read_text())["address"]
    finally:
        scheduler.kill()
        scheduler.wait()


def test_a_scheduler_that_is_lost_is_one_line(tmp_path):
    with scheduler_alone(tmp_path) as (scheduler, address):
        threading.Timer(1.0, scheduler.kill).start()
        with pytest.raises(ManifoldError, match=r"the scheduler was lost; run again"):
            there(address, squared, [1])


def test_a_scheduler_without_the_package_is_one_line(tmp_path):
    (tmp_path / "sitecustomize.py").write_text("import sys; sys.modules['manifold'] = None")
    with (
        scheduler_alone(tmp_path, PYTHONPATH=str(tmp_path)) as (_, address),
        pytest.raises(ManifoldError, match=r"the scheduler lacks this package; start it in the environment"),
    ):
        there(address, squared, [1])


def test_no_scheduler_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.2)
    with pytest.raises(ManifoldError, match=r"tcp://127\.0\.0\.1:1: no Dask scheduler answers .*; start one"):
        there("tcp://127.0.0.1:1", squared, [1])


def test_a_peer_that_says_nothing_is_no_scheduler(monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(ManifoldError, match=f"{address}: no Dask scheduler answers"):
            there(address, squared, [1])


@pytest.mark.parametrize("address", ["inproc://x", "tls://127.0.0.1:1"])
def test_a_client_that_never_connected_prints_nothing_when_it_is_deleted(address, monkeypatch):
    unraisable = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    with pytest.raises(ManifoldError, match="no Dask scheduler answers"):
        there(address, squared, [1])
    gc.collect()
    assert not unraisable


@pytest.mark.parametrize(
    "address",
    [
        "",
        "nonsense",
        "tcp://",
        "http://a:1",
        "tcp://a:b",
        "tcp://127.0.0.1",
        "tcp://a b:1",
        "a:99999",
        "a:0",
        "@:1",
    ],
)
def test_what_is_no_address_is_refused(address):
    with pytest.raises(UsageError, match=r"expected an address such as tcp://10\.0\.0\.1:8786"):
        there(address, squared, [1])


def test_without_dask_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'brdf-manifold\[cluster\]'"):
        there("tcp://127.0.0.1:8786", squared, [1])


def test_workers_and_a_scheduler_are_one_too_many():
    with pytest.raises(UsageError, match=r"--workers 2 and --scheduler here, expected one of them"):
        WorkerOptions(2, "here").executor()
    for options, expected in ((WorkerOptions(3), 3), (WorkerOptions(1), None), (OneWorkerOptions(), None)):
        with options.executor() as workers:
            assert getattr(workers, "_max_workers", None) == expected


def test_a_single_task_starts_no_process():
    with work.processes(8) as workers:
        assert results(pid_of, [None], workers) == [os.getpid()]


def test_an_interruption_cancels_what_waits_and_keeps_what_runs(monkeypatch):
    started, end = threading.Event(), threading.Event()

    def wait_for(name):
        started.set()
        end.wait(60)
        return name

    def interrupted(waiting):
        started.wait(60)
        threading.Timer(1.0, end.set).start()
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(work, "as_completed", interrupted)
    with ThreadPoolExecutor(1) as workers:
        found = work.run(wait_for, ["first", "second"], workers)
        assert next(found) == (0, "first", None)
        with pytest.raises(KeyboardInterrupt):
            next(found)
