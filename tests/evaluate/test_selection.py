"""Settings chosen by the errors of left-out materials."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest
from helpers.small_library import measured

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.errors import UsageError
from manifold.evaluate.selection import PAYS, choose
from manifold.model.settings import BlendSettings, GplvmSettings
from manifold.registries import MAPPINGS

NAMES = [m.name for m in corpus.isotropic_materials()][::6]


@pytest.fixture(scope="module")
def materials():
    return [MeasuredBRDF(measured(name)) for name in NAMES]


def test_the_mapping_with_the_least_held_out_error_is_chosen(materials):
    settings, tried = choose(materials, GplvmSettings(optimizer="l-bfgs"), mapping=True, latent_dim=False)
    assert {c.mapping for c in tried} == set(MAPPINGS)
    best = min(tried, key=lambda c: c.error)
    assert settings.mapping == best.mapping
    assert [c.is_chosen for c in tried] == [c.mapping == best.mapping for c in tried]
    assert settings.latent_dim == 2


def test_dimensions_are_added_while_they_pay(materials):
    settings, tried = choose(materials, GplvmSettings(optimizer="l-bfgs"), mapping=False, latent_dim=True)
    by_count = {c.latent_dim: c.error * c.detour for c in tried}
    chosen = settings.latent_dim
    assert by_count[chosen] == min(score for count, score in by_count.items() if count <= chosen)
    for few, more in pairwise(range(chosen, max(by_count) + 1)):
        assert by_count[more] >= (1 - PAYS) * by_count[chosen], f"{more} pays more than {few}"


def test_a_copy_in_the_library_makes_a_left_out_material_easy(materials):
    error = [
        choose(known, GplvmSettings(optimizer="l-bfgs"), mapping=False, latent_dim=False)[1][0].error
        for known in (materials[:5], materials[:5] * 2)
    ]
    assert error[1] < 0.5 * error[0]


def test_candidates_have_three_errors_and_plain_json(materials):
    tried = choose(materials[:5], BlendSettings(), mapping=False, latent_dim=False)[1][0]
    median, p90 = tried.median, tried.p90
    assert 0 < median.linear <= p90.linear
    assert 0 < median.ball <= p90.ball
    assert median.linear != median.cube_root
    document = json.loads(json.dumps(tried.to_json()))
    assert (document["median"], document["p90"]) == (median.to_json(), p90.to_json())


def test_of_mappings_only_those_are_tried_that_the_kind_takes(materials):
    """Blends are non-negative combinations of cube roots: nothing is left to choose."""
    settings, tried = choose(materials[:5], BlendSettings(), mapping=True, latent_dim=False)
    assert [c.mapping for c in tried] == [settings.mapping] == ["cube-root"]


def test_three_materials_are_too_few(materials):
    with pytest.raises(UsageError, match="at least 4"):
        choose(materials[:3], BlendSettings(), mapping=True, latent_dim=True)
