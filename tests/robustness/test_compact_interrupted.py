"""Compacting a library: a process that is killed at any moment."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.sample_files import assert_same
from helpers.small_library import NAMES, measured

from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.compacting import compact_library
from manifold.library.importing import import_files
from manifold.library.store import Library

pytestmark = pytest.mark.slow

ROUNDS, COPIES = 10, 5


def start(library):
    return subprocess.Popen(
        [sys.executable, "-m", "manifold", "compact", str(library)], stdout=subprocess.DEVNULL
    )


def test_a_killed_process_leaves_every_material_whole_and_another_run_completes_it(tmp_path, rng):
    (tmp_path / "files").mkdir()
    for name in NAMES:
        for k in range(COPIES):
            write_bsdf(tmp_path / "files" / f"{name}_{k}_rgb.bsdf", measured(name))
    import_files(tmp_path / "imported.zarr", [tmp_path / "files"])
    originals = {file.name: file for file in map(read_bsdf, sorted((tmp_path / "files").iterdir()))}
    library, counts = tmp_path / "library.zarr", []
    shutil.copytree(tmp_path / "imported.zarr", library)
    began = time.monotonic()
    assert start(library).wait() == 0
    duration_s = time.monotonic() - began
    for moment in 0.3 + 0.7 * (np.arange(ROUNDS) + rng.random(ROUNDS)) / ROUNDS:  # it starts up before
        shutil.rmtree(library)
        shutil.copytree(tmp_path / "imported.zarr", library)
        program = start(library)
        time.sleep(moment * duration_s)
        program.send_signal(signal.SIGKILL)
        program.wait()
        opened = Library(library)
        assert opened.names == tuple(originals)
        assert opened.verify() == []
        finished = [name for name in opened.names if opened.attributes(name).accuracy is not None]
        for name in set(opened.names) - set(finished):
            assert_same(opened.read(name), originals[name])
        counts.append(len(finished))
        result = compact_library(library)
        assert list(result.skipped) == finished
        assert len(result.compacted) == len(originals) - len(finished)
        assert len(list((library / "materials").glob("*/*"))) == 3 * len(originals)
        assert {path.suffix for path in tmp_path.glob(".*")} <= {".lock"}  # locks stay, empty
    assert any(0 < count < len(originals) for count in counts), counts
    print(counts)
