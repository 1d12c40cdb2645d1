"""Calibrations of completions that are shipped with the built-in library."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import built_in
import numpy as np
import pytest
from other_machines import environment

from manifold.core.shipped import BUILT_IN
from manifold.estimate import coat, completions, evidence, expected
from manifold.estimate.instruments import read
from manifold.formats.readings import Readings
from manifold.library.store import Library

FIND = """
import sys, tempfile
from pathlib import Path
import built_in
from manifold.estimate import coat, evidence, expected
from manifold.estimate.atoms import LibraryAtoms
from manifold.library.store import Library

def refuse(*_):
    raise SystemExit("a calibration was not found")

expected._calibrated = coat._calibrated = refuse
library = Library("built-in")
atoms = LibraryAtoms.of_library(library)
with tempfile.TemporaryDirectory() as folder:
    for readings in built_in.observations(Path(folder)):
        found = expected.calibrate(atoms, evidence.for_library(readings, library.bands), library)
        print(len(found.residuals))
print(coat.expected_errors(atoms, (60.0,), library).ball)
"""


@pytest.fixture
def atoms():
    return completions.atoms_of(Library(BUILT_IN))


@pytest.fixture
def only_shipped(monkeypatch, tmp_path):
    """Fail where a calibration is made, or one of the user's cache is taken."""

    def refuse(*_):
        raise AssertionError("not found among those that are shipped")

    monkeypatch.setattr(expected, "_calibrated", refuse)
    monkeypatch.setattr(coat, "_calibrated", refuse)
    monkeypatch.setattr("manifold.library.store.user_cache_path", lambda name: tmp_path / name)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="core types are those of x86-64")
@pytest.mark.parametrize("core", ["Prescott", "Haswell"])
def test_calibrations_are_found_on_other_core_types(core, tmp_path):
    folder = os.path.dirname(built_in.__file__)
    variables = os.environ | environment(core) | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": folder}
    run = subprocess.run([sys.executable, "-c", FIND], env=variables, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    *counts, ball = run.stdout.split()
    assert counts == ["20"] * 4
    assert 0.5 < float(ball) < 50.0


def test_the_order_of_readings_and_their_wavelengths_do_not_matter(atoms, only_shipped, tmp_path):
    readings = next(iter(built_in.observations(tmp_path)))
    order = np.random.default_rng(0).permutation(len(readings))
    nm = np.arange(380.0, 731.0, 10.0)
    shuffled = Readings(
        "sample", "of another kind", readings.wi[order] + 1e-9, readings.wo[order], nm,
        np.full((len(readings), len(nm)), 0.1),
    )  # fmt: skip
    assert len(expected.calibrate(atoms, shuffled, Library(BUILT_IN)).residuals) == 20


def test_a_workbook_has_the_directions_of_the_calibration(atoms, only_shipped, tmp_path):
    from manifold.analytic import virtual_instruments
    from manifold.analytic.diffuse import RoughDiffuse

    brdf = RoughDiffuse(np.array(0.5), 0.0, virtual_instruments.MA_T12_BANDS)
    virtual_instruments.write_ma_t12(tmp_path / "grey.xlsx", brdf, "grey", np.random.default_rng(0))
    readings, _ = read([tmp_path / "grey.xlsx"], None)
    assert (
        len(
            expected.calibrate(
                atoms, evidence.for_library(readings, atoms.bands), Library(BUILT_IN)
            ).residuals
        )
        == 20
    )


def test_other_directions_are_calibrated(atoms, only_shipped):
    wi = np.array([[0.6, 0.0, 0.8]])
    readings = Readings("sample", "", wi, wi, None, np.full((1, 3), 0.1))
    with pytest.raises(AssertionError, match="not found"):
        expected.calibrate(atoms, readings, Library(BUILT_IN))
