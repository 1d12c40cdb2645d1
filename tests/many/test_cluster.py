"""Whole workflows by the workers of a Dask scheduler: what they write is what this process would have written."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers.sample_files import write_samples
from helpers.small_library import small_library

from manifold.analytic.base import Lambert
from manifold.analytic.virtual_instruments import MA_T12_BANDS, write_ma_t12
from manifold.convert.targets import Options
from manifold.core import cluster, pairs
from manifold.estimate.inputs import find_inputs, find_samples
from manifold.estimate.sources import FileSource
from manifold.evaluate import embed, make_report
from manifold.library import importing
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.many import commands as many
from manifold.many.batch import batch
from manifold.model.manifold import Settings
from manifold.model.output_file import OutputOptions
from manifold.study.chart import make_chart
from manifold.study.stability.catalogue import MODES
from manifold.study.stability.trials import run_modes, select_modes

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def workers():
    """Two workers in threads of this process."""
    with (
        distributed.LocalCluster(n_workers=2, processes=False, dashboard_address=":0") as made,
        cluster.workers(made.scheduler_address) as executor,
    ):
        yield executor


def contents(folder, pattern="*"):
    """All files below a folder, by path."""
    return {
        str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob(pattern) if path.is_file()
    }


@pytest.mark.parametrize("tolerance", [None, 0.2])
def test_an_import_makes_the_same_library(tmp_path, workers, tolerance):
    library = small_library(tmp_path)
    found = {}
    for name, someone in (("here", None), ("there", workers)):
        made = import_files(tmp_path / name, tmp_path / "files", tolerance=tolerance, workers=someone)
        assert len(made.imported) == len(Library(library).names)
        found[name] = contents(tmp_path / name)
    assert found["here"] == found["there"]


def test_a_material_that_is_stored_again_is_the_same(tmp_path, monkeypatch):
    write_samples(tmp_path / "files", 2)
    store = importing._stored

    def twice(*arguments):  # as where a worker was lost before it said that it was done
        for _ in range(2):
            assert store(*arguments[:2], tmp_path / "staged", arguments[3]) is None
            shutil.rmtree(tmp_path / "staged")

    import_files(tmp_path / "once", tmp_path / "files")
    monkeypatch.setattr(importing, "_stored", twice)
    with ThreadPoolExecutor(1) as one:
        made = import_files(tmp_path / "twice", tmp_path / "files", workers=one)
    assert made.imported == ("m00", "m01")
    assert contents(tmp_path / "twice") == contents(tmp_path / "once")


def test_an_embedding_is_the_same(tmp_path, workers):
    library, models = small_library(tmp_path), {}
    for name, someone in (("here", None), ("there", workers)):
        model, _ = embed(library, tmp_path / f"{name}.h5", Settings(), workers=someone)
        models[name] = model
    here, there = models.values()
    # Where arrays lie in memory may decide the last bits of sums, which the search for places carries on.
    np.testing.assert_allclose(here.X, there.X, atol=1e-9)
    assert here.left_out.arrays.keys() == there.left_out.arrays.keys()
    for name, values in here.left_out.arrays.items():
        np.testing.assert_allclose(values, there.left_out.arrays[name], atol=1e-7, err_msg=name)


def numbers_of(made):
    """All of a report but times."""
    content = made.to_json()
    del content["seconds"]
    for method in content["methods"]:
        for name in ("fit_seconds", "encode_seconds", "predict_seconds"):
            del method[name]
    return content


@pytest.mark.slow
def test_a_report_has_the_same_errors(tmp_path, workers, monkeypatch):
    monkeypatch.setitem(pairs.NAMED_GRIDS, "default", pairs.RusinkiewiczGrid(20, 11, 6))
    sent, submit = [], workers.submit
    monkeypatch.setattr(workers, "submit", lambda f, *args: (sent.append(args[-1]), submit(f, *args))[1])
    embed(small_library(tmp_path), tmp_path / "model.h5", Settings(kind="material"))
    here, there = (make_report(tmp_path / "model.h5", workers=who) for who in (None, workers))
    assert {task.method for task in sent} >= {"published", "gp_refitted"}
    assert numbers_of(there) == numbers_of(here)


def test_a_chart_has_the_same_errors(tmp_path, workers):
    library = Library(small_library(tmp_path))
    files, keys = [library.read(name) for name in library.names], ["nearest"]
    grid = pairs.RusinkiewiczGrid(20, 11, 6)
    here, there = (
        make_chart(files, keys, grid=grid, library=library, workers=who) for who in (None, workers)
    )
    for a, b in zip(here.rows, there.rows, strict=True):
        for name in ("key", "median", "bytes"):
            assert getattr(a, name) == getattr(b, name)
    assert there.reference_seconds > 0.0


@pytest.mark.slow
def test_failure_modes_have_the_same_results(workers):
    modes = select_modes(MODES, ["ill_conditioned_kernel"])
    here = run_modes(modes)
    assert len(here.rows) == 1
    assert run_modes(modes, workers=workers) == here


@pytest.mark.slow
def test_completions_and_conversions_are_the_same(tmp_path, workers, rng):
    library = small_library(tmp_path)
    samples = tmp_path / "samples"
    samples.mkdir()
    for k in range(3):
        grey = Lambert(np.full(MA_T12_BANDS.count, 0.1 + 0.2 * k), MA_T12_BANDS)
        write_ma_t12(samples / f"s{k}.xlsx", grey, f"s{k}", rng)
    files = find_inputs([FileSource(tmp_path / "files")])[:2]
    command, found = many.completions_of(library, options=OutputOptions(resolution=8)), {}
    for name, someone in (("here", None), ("there", workers)):
        out = tmp_path / name
        outcomes = [
            *batch(command, find_samples([samples]), out / "a", someone).outcomes,
            *batch(many.conversions("rgl", options=Options()), files, out / "b", someone).outcomes,
        ]
        assert [o.failure for o in outcomes] == [None] * 5
        found[name] = contents(out, "*.bsdf") | contents(out, "*.png")
    assert len(found["here"]) == 2 * 5 + 2
    assert found["here"] == found["there"]
