"""Failure modes: nothing is silently wrong and no alarm is false; without a guard something is silently wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from manifold import gpr
from manifold.brdf import goniometer
from manifold.fit import fit_samples, principled
from manifold.model import diagnostics, embedding
from manifold.model import manifold as model
from manifold.model.manifold import Manifold
from manifold.render import backend
from manifold.study.stability import fit_failures, testbed
from manifold.study.stability.catalogue import MODES
from manifold.study.stability.data_failures import lost_cells
from manifold.study.stability.testbed import MIDDLE, TestBed
from manifold.study.stability.trials import FINE, REFUSED, WARNED, WRONG, TrialResult, run_trial

BY_KEY = {mode.key: mode for mode in MODES}
ROWS = [(mode.key, method) for mode in MODES for method in mode.methods]
SEARCHES = {"adam", "swarm"}  # their severe end takes many seconds
LIBRARIES = {"duplicates", "near_duplicates", "outlier", "no_noise", "long_length_scale", "many_dimensions"}
"""Modes that import a library, or fit a model, per trial: quick tests try only blends, at the severe end.

Of other modes they try every method there ("Principled fit" in `exact_zeros` alone), and one at the harmless end."""
TRIED_BELOW = {
    ("short_length_scale", "gplvm"),
    ("ill_conditioned_kernel", "GP"),
}
"""Their severe end must warn, with a guard, and be wrong without it."""
HARMLESS = [
    (m.key, "blend" if "blend" in m.methods else next(iter(m.methods)))
    for m in MODES
    if m.key not in LIBRARIES - {"duplicates"}
]
QUICK = [
    (key, method)
    for key, method in ROWS
    if (method == "blend" if key in LIBRARIES else method != "Principled fit" or key == "exact_zeros")
]


@pytest.fixture(scope="module", autouse=True)
def coarse_files() -> Iterator[None]:
    """Files of the family at fewer directions: what is found by the package's own is found by these."""
    with pytest.MonkeyPatch.context() as patch:
        coarse = partial(goniometer.measure, resolution=20, n_theta_i=8)
        patch.setattr(testbed, "goniometer", SimpleNamespace(measure=coarse))
        yield


@pytest.fixture(scope="module")
def bed() -> Iterator[TestBed]:
    with threadpool_limits(1, "blas"), TestBed() as made:
        yield made


@pytest.fixture
def fresh_bed(bed) -> Iterator[TestBed]:
    """One of the same files that remembers nothing of what was said before a guard was taken away."""
    with threadpool_limits(1, "blas"), TestBed() as made:
        made.family = bed.family
        yield made


def unguarded(bed: TestBed, key: str, method: str, severity: float | None = None) -> TrialResult:
    """One trial, by default the most severe, with what is patched now."""
    mode = BY_KEY[key]
    return run_trial(mode, method, bed, mode.severities[-1] if severity is None else severity)


def tried(bed: TestBed, key: str, method: str, severity: float | None = None) -> TrialResult:
    """The same as the package is, once for all tests."""
    if method == "adam" and not backend.mitsuba(colour="rgb").variant().startswith("llvm"):
        pytest.skip("adam needs LLVM")
    severity = BY_KEY[key].severities[-1] if severity is None else severity
    return bed.cached(("tried", key, method, severity), lambda: unguarded(bed, key, method, severity))


@pytest.mark.slow
@pytest.mark.parametrize(("key", "method"), ROWS)
def test_no_severity_is_silently_wrong_and_the_first_one_is_fine(bed, key, method):
    found = [tried(bed, key, method, severity) for severity in BY_KEY[key].severities]
    assert not any(one.outcome == WRONG for one in found)
    assert (found[0].outcome, found[0].message) == (FINE, "")


@pytest.mark.parametrize(
    ("key", "method"), [row for row in QUICK if row not in TRIED_BELOW and row[1] not in SEARCHES]
)
def test_the_severe_end_is_not_silently_wrong(bed, key, method):
    assert tried(bed, key, method).outcome != WRONG


@pytest.mark.parametrize(("key", "method"), HARMLESS)
def test_the_harmless_end_is_no_false_alarm(bed, key, method):
    found = tried(bed, key, method, BY_KEY[key].severities[0])
    assert (found.outcome, found.message) == (FINE, "")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
def test_lost_cells_are_the_share_of_the_measured_ones_that_was_asked_for(bed, share):
    file = bed.file(MIDDLE)
    lost = lost_cells(file, share)
    assert not np.any(lost & ~file.measured_mask)
    assert lost.sum() / file.measured_mask.sum() == pytest.approx(share, abs=0.03)


# -- models: a guard taken away -----------------------------------------------------------------------------


def test_without_the_flag_of_extrapolation_a_short_length_scale_is_silently_wrong(bed, monkeypatch):
    assert tried(bed, "short_length_scale", "gplvm").outcome == WARNED
    monkeypatch.setattr(Manifold, "is_extrapolation", lambda *_: False)
    assert unguarded(bed, "short_length_scale", "gplvm").outcome == WRONG


def test_without_a_word_about_jitter_an_ill_conditioned_kernel_is_silently_wrong(bed, monkeypatch):
    assert tried(bed, "ill_conditioned_kernel", "GP").outcome == WARNED
    monkeypatch.setattr(gpr, "warnings", SimpleNamespace(warn=lambda *_, **__: None))
    assert unguarded(bed, "ill_conditioned_kernel", "GP").outcome == WRONG


@pytest.mark.parametrize(
    ("key", "method", "severity"),
    [("long_length_scale", "gplvm", 1000.0), ("bad_starts", "l-bfgs", 100.0)],
)
def test_without_the_warning_of_fits_that_predict_little_they_are_silently_wrong(
    bed, monkeypatch, key, method, severity
):
    assert tried(bed, key, method, severity).outcome == WARNED
    monkeypatch.setattr(gpr.GaussianProcess, "warn_of_fit", lambda *_: None)
    monkeypatch.setattr(diagnostics, "MOST_EMBEDDING_BALL", np.inf)
    assert unguarded(bed, key, method, severity).outcome == WRONG


def test_without_the_diagnostic_an_impossible_reflectance_is_silently_wrong(bed, monkeypatch):
    monkeypatch.setattr(diagnostics, "MOST_RESIDUAL", np.inf)
    monkeypatch.setattr(Manifold, "is_extrapolation", lambda *_: False)
    assert unguarded(bed, "impossible_reflectance", "blend").outcome == WRONG


def test_without_the_diagnostic_a_lobe_sharper_than_the_library_is_silently_wrong(bed, monkeypatch):
    for name in ("MOST_EMBEDDING_ERROR", "MOST_EMBEDDING_BALL", "MOST_ALBEDO"):
        monkeypatch.setattr(diagnostics, name, np.inf)
    assert unguarded(bed, "sharper_than_library", "blend").outcome == WRONG


def test_without_diagnostics_of_plausibility_raw_values_are_silently_wrong_outside(fresh_bed, monkeypatch):
    for name in ("MOST_NEGATIVE", "MOST_ALBEDO", "MOST_NON_RECIPROCAL", "MOST_VALLEY"):
        monkeypatch.setattr(diagnostics, name, np.inf)
    assert unguarded(fresh_bed, "outside_materials", "raw values", 0.5).outcome == WRONG


# -- files and libraries: a guard taken away -----------------------------------------------------------------


def test_predictions_at_materials_are_wrong_if_unmeasured_cells_are_not_filled(bed, fresh_bed, monkeypatch):
    assert tried(bed, "exact_zeros", "prediction at a material", 0.1).outcome == WARNED
    monkeypatch.setattr("manifold.model.diagnostics.of_unmeasured", lambda share: ())
    monkeypatch.setattr("manifold.model.diagnostics.MOST_VALLEY", 1.0)
    assert unguarded(bed, "exact_zeros", "prediction at a material", 0.1).outcome == FINE
    monkeypatch.setattr("manifold.model.materials.fill_unmeasured", lambda file, *_, **__: file)
    assert unguarded(fresh_bed, "exact_zeros", "prediction at a material", 0.1).outcome != FINE


def test_without_filling_and_diagnostic_embedded_unmeasured_cells_are_silently_wrong(bed, monkeypatch):
    monkeypatch.setattr("manifold.model.diagnostics.of_unmeasured", lambda share: ())
    monkeypatch.setattr(diagnostics, "MOST_EMBEDDING_BALL", np.inf)
    assert unguarded(bed, "exact_zeros", "embedding a file", 0.1).outcome == FINE
    monkeypatch.setattr("manifold.model.location.fill_unmeasured", lambda file, cells: file)
    assert unguarded(bed, "exact_zeros", "embedding a file", 0.1).outcome == WRONG


def test_without_the_warning_of_another_hash_exchanged_materials_are_silently_wrong(bed, monkeypatch):
    assert tried(bed, "changed_library", "exchanged").outcome == WARNED
    for module in (model, embedding):
        monkeypatch.setattr(module, "warnings", SimpleNamespace(warn=lambda *a, **k: None))
    assert unguarded(bed, "changed_library", "exchanged").outcome == WRONG


# -- fits: a guard taken away --------------------------------------------------------------------------------


def test_a_single_direction_is_refused(bed):
    assert tried(bed, "few_directions", "gauss-newton").outcome == REFUSED


def test_a_swarm_is_silently_wrong_where_nobody_looks_for_a_step_down(bed, monkeypatch):
    assert tried(bed, "local_minima", "swarm", 3.0).outcome == WARNED
    monkeypatch.setattr(
        "manifold.fit.identifiability.gauss_newton_step", lambda layout, p, *_: (0.0 * p, float("inf"))
    )
    assert unguarded(bed, "local_minima", "swarm", 3.0).outcome == WRONG


def test_brushed_metal_is_not_called_diffuse_where_diffuse_fits_no_better():
    samples = replace(fit_samples.from_brdf(fit_failures.brushed(10.0)), is_isotropic=True)
    found = principled.fit_bsdf(samples)  # `anisotropic` is not free
    assert found.family.type == "principled"
    assert any("does not fit" in note for note in found.notes)


def test_smooth_grey_is_silently_wrong_where_rivals_are_not_told(bed, monkeypatch):
    made = principled._result

    def sure(*arguments, **known):
        found = made(*arguments, **known)
        statements = tuple(replace(s, state="determined") for s in found.statements)
        return replace(found, statements=statements, notes=(), minima=found.minima[:1])

    monkeypatch.setattr(principled, "_result", sure)
    assert unguarded(bed, "rough_or_smooth", "gauss-newton, smooth grey").outcome == WRONG


def test_without_notes_mirrors_that_no_parameters_reach_are_silently_wrong(bed, monkeypatch):
    assert tried(bed, "mirror_fit", "gauss-newton").outcome == WARNED
    monkeypatch.setattr(principled, "_notes", lambda *_: [])
    assert unguarded(bed, "mirror_fit", "gauss-newton").outcome == WRONG
