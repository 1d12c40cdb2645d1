"""Commands whose work a Dask scheduler's workers share: the command is killed at any moment."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.sample_files import assert_same, write_samples
from helpers.small_library import small_library

from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.manifold import Manifold

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

ROUNDS, FILES = 10, 40


@pytest.fixture(scope="module")
def address():
    """Of the scheduler of two workers."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as made:
        yield made.scheduler_address


def start(address, *words):
    words = [*map(str, words), "--scheduler", address]
    return subprocess.Popen([sys.executable, "-m", "manifold", *words], stdout=subprocess.DEVNULL)


def killed(rng, begin, forget):
    """Run a command, then kill it, once in each tenth of the time that it takes; forget what it made before."""
    began = time.monotonic()
    assert begin().wait() == 0
    duration_s = time.monotonic() - began
    for moment in 0.3 + 0.7 * (np.arange(ROUNDS) + rng.random(ROUNDS)) / ROUNDS:  # it starts up before
        forget()
        program = begin()
        time.sleep(moment * duration_s)
        program.send_signal(signal.SIGKILL)
        program.wait()
        yield moment


def test_a_killed_import_keeps_whole_materials_and_another_run_completes_it(tmp_path, rng, address):
    write_samples(tmp_path / "files", FILES)
    originals = {file.name: file for file in map(read_bsdf, (tmp_path / "files").iterdir())}
    library, counts = tmp_path / "library.zarr", []

    def begin():
        return start(address, "import", tmp_path / "files", "-L", library)

    def forget():
        time.sleep(1.0)  # workers end the tasks that they are at
        shutil.rmtree(library)

    for _ in killed(rng, begin, forget):
        names = Library(library).names if library.exists() else ()
        for name in names:
            assert_same(Library(library).read(name), originals[name])
        counts.append(len(names))
        assert begin().wait() == 0
        assert Library(library).names == tuple(sorted(originals))
        assert Library(library).verify() == []
    assert any(0 < count < FILES for count in counts), counts
    print(counts)


def test_a_killed_embedding_leaves_no_half_model_and_another_run_completes_it(tmp_path, rng, address):
    library, model, there = small_library(tmp_path), tmp_path / "model.h5", []
    X = Manifold.fit(library).X

    def forget():
        time.sleep(1.0)
        model.unlink(missing_ok=True)

    def begin():
        return start(address, "embed", "-L", library, "-M", model)

    for _ in killed(rng, begin, forget):
        there.append(model.exists())
        if there[-1]:
            np.testing.assert_array_equal(Manifold.load(model, library).X, X)
        assert Library(library).verify() == []
        assert begin().wait() == 0
        np.testing.assert_array_equal(Manifold.load(model, library).X, X)
    print(there)
