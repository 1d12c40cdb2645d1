"""Diagnostics of predictions and embeddings."""

from __future__ import annotations

import pytest

from manifold.brdf.plausibility import Plausibility
from manifold.core.judged_lights import BALL
from manifold.core.metrics import Errors
from manifold.model import diagnostics

SOUND = Plausibility(negative_share=0.0, reciprocity_error=0.0, max_albedo=0.9, highlight_valley=0.05)


def test_a_sound_result_has_no_diagnostics():
    assert diagnostics.of_prediction(False, SOUND) == ()
    assert diagnostics.of_embedding(Errors(ball=1.0, linear=0.1)) == ()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((True, SOUND), "not supported by the data"),
        ((False, Plausibility(0.2, 0.0, 0.9, 0.0)), "20 % of the values were negative"),
        ((False, Plausibility(0.0, 0.0, 3.0, 0.0)), "albedo 3.00 at 0 degrees"),
        ((False, Plausibility(0.0, 0.6, 0.9, 0.0)), "differ by 60 %"),
        (
            (False, Plausibility(0.0, 0.0, 0.9, 0.3)),
            "dark hole or ring near the mirror direction: 30 % below",
        ),
        ((False, SOUND, 0.3), "error up to 0.30"),
    ],
)
def test_each_defect_of_a_prediction_has_its_diagnostic(arguments, said):
    (sentence,) = diagnostics.of_prediction(*arguments)
    assert said in sentence


def test_what_a_measured_file_has_of_its_own_is_not_said_against_the_place():
    negative, ring = diagnostics.of_measured(Plausibility(0.12, 0.0, 0.9, 0.3))
    assert "12 % of the measured values are negative" in negative
    assert "the measured file has a dark hole or ring near the mirror direction, 30 % deep" in ring
    assert diagnostics.of_measured(SOUND) == ()


def test_a_material_outside_the_manifold_is_diagnosed():
    for error, ball in ((0.8, 1.0), (0.1, 7.5)):
        (sentence,) = diagnostics.of_embedding(Errors(ball=ball, linear=error))
        assert f"error {error:.2f}, {ball} {BALL}: outside the manifold" in sentence


def test_an_expected_error_in_words_names_what_it_is_of_and_how_sure_it_is():
    own = Errors(ball=1.6, cube_root=0.04)
    assert diagnostics.in_words(own, 20, "of a material of this colour: ") == (
        [f"of a material of this colour: 1.6 {BALL}", "4 % cube-root error"],
        "90 % of true errors are below twice this value",
    )
    assert (
        diagnostics.in_words(own, 5)[-1] == "uncertain by a factor of three: the model has only 5 materials"
    )
    assert diagnostics.in_words(Errors(ball=0.01, cube_root=0.001), 20) == (diagnostics.AT_A_MATERIAL,)
    assert diagnostics.in_words(None, 3)[0].startswith("unknown: ")


def test_unmeasured_cells_are_diagnosed_from_one_percent_on():
    assert diagnostics.of_unmeasured(0.005) == ()
    (sentence,) = diagnostics.of_unmeasured(0.12)
    assert "12 %" in sentence
