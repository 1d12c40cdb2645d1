"""Files, libraries and models that fail are never silently wrong, and are where a guard is taken away."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from manifold import io_rgl
from manifold.experiments.stability import data_failures, library_failures
from manifold.experiments.stability.bench import MIDDLE, Bench
from manifold.experiments.stability.data_failures import lost_cells
from manifold.experiments.stability.trials import FINE, REFUSED, WARNED, WRONG, Mode, Tried, try_once
from manifold.library import importing, store
from manifold.model import manifold as model
from manifold.model import model_file

MODES = (*data_failures.MODES, *library_failures.MODES)
ROWS = [(mode.key, method) for mode in MODES for method in mode.methods]


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with Bench() as made:
        yield made


def mode_named(key: str) -> Mode:
    return next(mode for mode in MODES if mode.key == key)


def tried(bench: Bench, key: str, method: str, severity: float | None = None) -> Tried:
    """One trial, by default the most severe."""
    mode = mode_named(key)
    severity = mode.severities[-1] if severity is None else severity
    return try_once(mode.methods[method], bench, severity, mode.threshold)


@pytest.mark.parametrize(("key", "method"), ROWS)
def test_no_row_is_silently_wrong_and_the_harmless_end_is_fine(bench, key, method):
    mode = mode_named(key)
    found = [tried(bench, key, method, severity) for severity in mode.severities]
    assert [one for one in found if one.outcome == WRONG] == []
    assert found[0].outcome == FINE


def test_keys_are_unique_and_every_advice_is_one_sentence():
    assert len({mode.key for mode in MODES}) == len(MODES)
    for mode in MODES:
        assert mode.advice.endswith(".")
        assert list(mode.methods)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
def test_lost_cells_are_the_share_of_the_measured_ones_that_was_asked_for(bench, share):
    file = bench.file(MIDDLE)
    lost = lost_cells(file, share)
    assert not np.any(lost & ~file.measured_mask)
    assert lost.sum() / file.measured_mask.sum() == pytest.approx(share, abs=0.03)


# Mutations: each takes one guard away.


def test_without_the_diagnostic_unmeasured_cells_are_silently_wrong(bench, monkeypatch):
    assert tried(bench, "exact_zeros", "prediction at a material", 0.1).outcome == WARNED
    monkeypatch.setattr("manifold.model.diagnostics.of_unmeasured", lambda share: ())
    assert tried(bench, "exact_zeros", "prediction at a material", 0.1).outcome == WRONG


def test_without_filling_and_diagnostic_embedded_unmeasured_cells_are_silently_wrong(bench, monkeypatch):
    monkeypatch.setattr("manifold.model.diagnostics.of_unmeasured", lambda share: ())
    assert tried(bench, "exact_zeros", "embedding a file").outcome == FINE
    monkeypatch.setattr("manifold.model.located.fill_unmeasured", lambda file, cells: file)
    assert tried(bench, "exact_zeros", "embedding a file").outcome == WRONG


def test_without_hashes_of_materials_turned_bits_are_silently_wrong(bench, monkeypatch):
    assert tried(bench, "flipped_bits", "prediction").outcome == REFUSED
    monkeypatch.setattr(store.Library, "read", store.Library._read)
    assert tried(bench, "flipped_bits", "prediction").outcome == WRONG


def test_without_the_hash_of_latents_turned_bits_are_silently_wrong(bench, monkeypatch):
    assert tried(bench, "flipped_latents", "prediction").outcome == REFUSED
    monkeypatch.setattr(model_file, "hash_arrays", lambda arrays: "")
    with Bench() as fresh:  # whose model is written without the hash
        assert tried(fresh, "flipped_latents", "prediction").outcome == WRONG


def test_without_the_warning_of_another_hash_exchanged_materials_are_silently_wrong(bench, monkeypatch):
    assert tried(bench, "changed_library", "exchanged").outcome == WARNED
    monkeypatch.setattr(model, "warnings", SimpleNamespace(warn=lambda *a, **k: None))
    assert tried(bench, "changed_library", "exchanged").outcome == WRONG


def test_without_the_check_of_values_files_with_nan_are_silently_wrong(bench, monkeypatch):
    monkeypatch.setattr(io_rgl, "_check_values", lambda tensors, reader: None)
    assert tried(bench, "not_a_number", "import").outcome == WRONG


def test_without_the_check_of_bands_other_bands_are_silently_wrong(bench, monkeypatch):
    monkeypatch.setattr(importing, "_require_one_grid", lambda loaded, expected, library: None)
    assert tried(bench, "other_bands", "import", 1.0).outcome == WRONG
