"""Diagnostics of a prediction or an embedding, as sentences; empty if there are none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from manifold.brdf.measured import BRDF
from manifold.brdf.physical import RECIPROCITY_ERROR
from manifold.brdf.plausibility import Plausibility, plausibility
from manifold.model.colours import ChosenColour, ColourChoice, choose_colour
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.model.prediction import PredictedBRDF
from manifold.models.expected_error import COARSE_BELOW
from manifold.records import Array

MOST_NEGATIVE = 0.005  # share of values, above which a prediction is diagnosed; one in a hundred is seen
MOST_ALBEDO = 1.05  # measured materials reach a little above 1 too
MOST_NON_RECIPROCAL = 0.5  # relative; measured materials reach 0.3, mirrors more
MOST_VALLEY = 0.1  # of the values beside it; measured materials reach 0.07
MOST_MISSED = 0.02  # of a reflectance
MOST_UNMEASURED = 0.01  # of the cells that should hold something
MOST_EMBEDDING_ERROR = 0.5  # relative: half of the material is not reconstructed
MOST_EMBEDDING_BALL = 5.0  # CIEDE2000: an observer sees two different colours (Mokrzycki & Tatol 2011)


@dataclass(frozen=True)
class Diagnosis:
    """Diagnostics and expected error of a prediction.

    Attributes:
        expected_ball: expected error, mean CIEDE2000 of the ball; None where the model is not calibrated.
        expected_cube_root: the same, relative error of cube roots.
        materials: number of materials of the model, on whose left-out errors expected ones are based.
        is_extrapolation: whether the data do not support the place.
        nearest: the three nearest materials with their distances.
        reflectance_missed: largest difference over bands between the requested reflectance and the one reached.
        plausibility: measured on the prediction, or on the file that was written.
        diagnostics: defects found, as sentences.
    """

    expected_ball: float | None
    expected_cube_root: float | None
    materials: int
    is_extrapolation: bool
    nearest: tuple[tuple[str, float], ...]
    reflectance_missed: float
    plausibility: Plausibility
    diagnostics: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return vars(self) | {"plausibility": vars(self.plausibility)}

    @property
    def rows(self) -> dict[str, object]:
        """Labels and values for a terminal."""
        physical = self.plausibility
        rows: dict[str, object] = {
            "expected error": in_words(self.expected_ball, self.expected_cube_root, self.materials),
            "nearest": [f"{name} ({distance:.2f})" for name, distance in self.nearest],
            "reciprocity error": f"{physical.reciprocity_error:.2%}",
            "largest albedo": f"{physical.max_albedo:.3f}",
        }
        return rows | ({"diagnostics": self.diagnostics} if self.diagnostics else {})


def diagnose(
    model: Manifold,
    x: Array,
    found: Plausibility,
    *,
    colours: Array | None = None,
    missed: float = 0.0,
    negative_share: float | None = None,
) -> Diagnosis:
    """Diagnostics and expected error of the prediction at a latent x (Q,).

    Args:
        model: that predicts.
        x: the latent.
        found: measurements on the prediction.
        colours: of the prediction.
        missed: largest difference over bands between the requested reflectance and the one reached.
        negative_share: share of negative values before they were cut to 0; None where `found` has it.
    """
    expected, nearest = model.expected_error(x, colours), tuple(model.nearest(x, 3))
    is_extrapolation = bool(model.is_extrapolation(x, colours))
    ball, cube_root = (None, None) if expected is None else (float(expected.ball), float(expected.cube_root))
    why = f"the nearest material is {nearest[0][1]:.1f} length scales away"
    if ball is not None:
        why += f", expected error {ball:.0f} CIEDE2000 of the ball"
    judged = found if negative_share is None else replace(found, negative_share=negative_share)
    if model.space.training_index(x, colours) is not None:
        sentences = of_measured(judged)
    else:
        sentences = of_prediction(is_extrapolation, judged, missed, why)
    sentences += of_unmeasured(model.unmeasured_share(x)) + model.notes
    return Diagnosis(ball, cube_root, len(model.names), is_extrapolation, nearest, missed, found, sentences)


def of_brdf(model: Manifold, x: Array, brdf: BRDF, chosen: ChosenColour) -> Diagnosis:
    """As `diagnose`, of a prediction at a latent x (Q,) that is not written: measured on the BRDF itself."""
    return diagnose(model, x, plausibility(brdf), colours=chosen.colours, missed=chosen.missed)


def predict_and_diagnose(
    model: Manifold, place: Place, choice: ColourChoice
) -> tuple[Array, PredictedBRDF, Diagnosis]:
    """The latent (Q,) of a place, the prediction there in a chosen colour, and its diagnosis."""
    x, chosen = model.require_latent(place), choose_colour(model, place, choice)
    brdf = model.predict(place, chosen.colours)
    return x, brdf, of_brdf(model, x, brdf, chosen)


def in_words(ball: float | None, cube_root: float | None, materials: int) -> list[str]:
    """An expected error for a terminal, of a model of `materials` materials."""
    if ball is None or cube_root is None:
        return ["unknown: the model is not calibrated", "embed again, with four materials or more"]
    if ball == 0.0 and cube_root == 0.0:
        return ["none: a measured material"]
    words = [
        f"{ball:.1f} CIEDE2000 of the ball",
        f"{cube_root:.0%} cube-root error",
        "90 % of errors below twice these",
    ]
    return words + [f"coarse: known from {materials} materials"] * (materials < COARSE_BELOW)


def of_prediction(
    is_extrapolation: bool, found: Plausibility, missed: float = 0.0, why: str = "far from all materials"
) -> tuple[str, ...]:
    """Of a prediction.

    Args:
        is_extrapolation: whether the data do not support it.
        found: measurements on it.
        missed: largest difference over bands between the requested reflectance and the one reached.
        why: the reason why the data do not support it.
    """
    diagnostics = []
    if is_extrapolation:
        diagnostics.append(f"not supported by the data: {why}; choose a latent nearer to the materials")
    if found.negative_share > MOST_NEGATIVE:
        diagnostics.append(
            f"{100.0 * found.negative_share:.2g} % of the values were negative; the data do not support this point"
        )
    if found.max_albedo > MOST_ALBEDO:
        diagnostics.append(
            f"not energy-conserving: directional albedo {found.max_albedo:.2f}; --physical scales it to 1"
        )
    if found.reciprocity_error > MOST_NON_RECIPROCAL:
        diagnostics.append(
            f"not reciprocal: f(wi, wo) and f(wo, wi) differ by {100.0 * found.reciprocity_error:.0f} %; "
            "--physical takes their mean"
        )
    if found.highlight_valley > MOST_VALLEY:
        diagnostics.append(
            f"dark hole or ring near the mirror direction: {100.0 * found.highlight_valley:.0f} % below both "
            "sides (measured materials: at most 7 %)"
        )
    if missed > MOST_MISSED:
        diagnostics.append(
            f"requested reflectance cannot be reached at this structure: error up to {missed:.2f}"
        )
    return tuple(diagnostics)


def of_measured(found: Plausibility) -> tuple[str, ...]:
    """Of a measured material at its own place."""
    sound = replace(found, negative_share=0.0, highlight_valley=0.0)
    diagnostics = list(of_prediction(False, sound))
    negative, valley = 100.0 * found.negative_share, 100.0 * found.highlight_valley
    if found.negative_share > MOST_NEGATIVE:
        diagnostics.append(
            f"{negative:.2g} % of the measured values are negative: noise, or colours outside sRGB"
        )
    if found.highlight_valley > MOST_VALLEY:
        diagnostics.append(
            f"the measured file has a dark hole or ring near the mirror direction, {valley:.0f} % deep"
        )
    return tuple(diagnostics)


def of_projection(found: Plausibility) -> tuple[str, ...]:
    """Of a file that was projected to be physical, by measurements on it."""
    if found.reciprocity_error <= RECIPROCITY_ERROR:
        return ()
    return (
        f"not reciprocal: the file's f(wi, wo) and f(wo, wi) still differ by {100.0 * found.reciprocity_error:.0f} %, "
        f"expected at most {100.0 * RECIPROCITY_ERROR:.0f} %; write more --resolution and --incidences",
    )


def of_unmeasured(share: float) -> tuple[str, ...]:
    """Of cells that were not measured, as a share of those that should hold something."""
    if share <= MOST_UNMEASURED:
        return ()
    return (
        f"{100.0 * share:.0f} % of the cells were not measured, but filled from neighbours; see `manifold info`",
    )


def of_anisotropy(is_isotropic: bool, is_found_isotropic: bool) -> tuple[str, ...]:
    """Of a material that is reconstructed from others, and whether it and the reconstruction are isotropic."""
    if is_isotropic or not is_found_isotropic:
        return ()
    return ("anisotropic, but reconstructed from isotropic materials: the same at all azimuths",)


def of_embedding(relative_error: float, ball: float) -> tuple[str, ...]:
    """Of an embedded material, by the errors of its reconstruction.

    Args:
        relative_error: linear.
        ball: mean CIEDE2000 of the ball.
    """
    if relative_error <= MOST_EMBEDDING_ERROR and ball <= MOST_EMBEDDING_BALL:
        return ()
    return (
        f"reconstruction error {relative_error:.2f}, {ball:.1f} CIEDE2000 of the ball: outside the manifold; import "
        "materials like it and embed again",
    )
