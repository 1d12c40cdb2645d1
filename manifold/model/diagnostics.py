"""Diagnostics of a prediction or an embedding, as sentences; empty if there are none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manifold import __version__
from manifold.brdf.measured import BRDF
from manifold.brdf.physical import RECIPROCITY_ERROR
from manifold.brdf.plausibility import Plausibility, albedo_at, plausibility
from manifold.metrics import Errors
from manifold.model.colours import NEAREST, UNCHOSEN, ChosenColour, ColourChoice, choose_colour
from manifold.model.expected_error import COARSE_BELOW
from manifold.records import Array, plain

if TYPE_CHECKING:
    from manifold.model.manifold import Manifold
    from manifold.model.places import Place, PlaceLike

MOST_NEGATIVE = 0.005  # share of values, above which a prediction is diagnosed; one in a hundred is seen
MOST_ALBEDO = 1.05  # measured materials reach a little above 1 too
MOST_NON_RECIPROCAL = 0.5  # relative; measured materials reach 0.3, mirrors more
MOST_VALLEY = 0.1  # depth of a valley over the values beside it; measured materials reach 0.04
MOST_RESIDUAL = 0.02  # difference between reflectances
MOST_UNMEASURED = 0.01  # share of the cells that should hold something
MOST_EMBEDDING_ERROR = 0.5  # relative: half of the material is not reconstructed
MOST_EMBEDDING_BALL = 5.0  # CIEDE2000: an observer sees two different colours (Mokrzycki & Tatol 2011)


@dataclass(frozen=True, kw_only=True, eq=False)
class DiagnosedPrediction:
    """A predicted material, with its expected error and diagnostics.

    Attributes:
        latent: shape (Q,).
        coordinates: the same, with the digits that reproduce the prediction.
        colour: where the colour comes from, in words; None where the latent fixes it.
        reflectance_residual: largest difference over bands between the requested reflectance and the one reached.
        weights: the materials with the largest weights, by magnitude, in this colour; none of a step of a walk, which
            its two materials make.
        nearest: the three nearest materials with their distances.
        materials: number of materials of the model, on whose left-out errors expected ones are based.
        expected: None where the model is not calibrated.
        is_extrapolation: whether the data do not support the place.
        plausibility: measured on the prediction, or on the file that was written.
        diagnostics: defects found, as sentences.
        attributes: those asked for and those reached, plain values; None where none were asked for.
        path: of the file that was written; None where none was.
        is_physical: whether that was projected to be non-negative, reciprocal and energy-conserving.
        clipped_share: share of the predicted values that were negative, and are zero in the file.
        mirror_difference: of the file from the prediction near mirror directions, see `plausibility.mirror_difference`.
        seconds: evaluating, checking and writing, without loading the library.
    """

    brdf: BRDF
    latent: Array
    coordinates: tuple[str, ...]
    colour: str | None
    reflectance_residual: float
    weights: list[tuple[str, float]]
    nearest: list[tuple[str, float]]
    materials: int
    expected: Errors[Array] | None
    is_extrapolation: bool
    plausibility: Plausibility
    diagnostics: tuple[str, ...]
    attributes: dict[str, Any] | None = None
    path: Path | None = None
    is_physical: bool = False
    clipped_share: float = 0.0
    mirror_difference: float = 0.0
    seconds: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Plain values; of a file that was written, also the program's version."""
        dropped = {"brdf"} | ({"attributes"} if self.attributes is None else set())
        if self.path is None:
            dropped |= {"path", "is_physical", "clipped_share", "mirror_difference", "seconds"}
        program = {} if self.path is None else {"program": f"manifold {__version__}"}
        return program | {key: plain(value) for key, value in vars(self).items() if key not in dropped}

    @property
    def rows(self) -> dict[str, object]:
        """Labels and values for a terminal."""
        rows: dict[str, object] = {
            "expected error": ["none: not supported by the data"]
            if self.is_extrapolation
            else in_words(self.expected, self.materials),
            "nearest": [f"{name} ({distance:.2f})" for name, distance in self.nearest],
            "reciprocity error": f"{self.plausibility.reciprocity_error:.2%}",
            "largest albedo": f"{self.plausibility.max_albedo:.3f}",
        }
        if self.path is not None:
            off = f"at most {self.mirror_difference:.1%} from the prediction"
            rows["file"] = f"{off} within 5 degrees of mirror directions"
        return rows | ({"diagnostics": self.diagnostics} if self.diagnostics else {})


def predict_and_diagnose(
    model: Manifold, x: PlaceLike, choice: ColourChoice = NEAREST
) -> DiagnosedPrediction:
    """The prediction at a place in a chosen colour, with its diagnostics."""
    place = model.place(x)
    chosen = choose_colour(model, place, choice)
    return diagnose(model, place, model.predict(place, chosen.colours), chosen)


def diagnose(
    model: Manifold,
    place: Place,
    brdf: BRDF,
    chosen: ChosenColour = UNCHOSEN,
    found: Plausibility | None = None,
    negative_share: float | None = None,
) -> DiagnosedPrediction:
    """Diagnostics and expected error of a prediction at a place, measured on the file that was written of it, with the
    share of negative values before they were cut to 0, or else on the prediction itself.
    """
    colours = chosen.colours
    found = plausibility(brdf) if found is None else found
    expected, nearest = model.expected_error(place, colours), model.nearest(place, 3)
    is_extrapolation = bool(model.is_extrapolation(place, colours))
    why = f"the nearest material is {nearest[0][1]:.1f} length scales away"
    if expected is not None:
        why += f", expected error {expected.ball:.0f} CIEDE2000 of the ball"
    measured = found if negative_share is None else replace(found, negative_share=negative_share)
    if model.space.training_index(place.latent, colours) is not None:
        sentences = of_measured(measured, brdf)
    else:
        sentences = of_prediction(is_extrapolation, measured, chosen.residual, why)
    return DiagnosedPrediction(
        brdf=brdf,
        latent=place.latent,
        coordinates=model.space.printed(place.latent),
        colour=chosen.words,
        reflectance_residual=chosen.residual,
        weights=model.largest_weights(place, 5, colours) if place.walk is None or colours is not None else [],
        nearest=nearest,
        materials=len(model.names),
        expected=expected,
        is_extrapolation=is_extrapolation,
        plausibility=found,
        diagnostics=sentences + of_unmeasured(model.unmeasured_share(place)) + model.notes,
    )


def in_words(expected: Errors[Array] | None, materials: int) -> list[str]:
    """An expected error for a terminal, of a model of `materials` materials."""
    if expected is None:
        return ["unknown: the model is not calibrated", "embed again, with four materials or more"]
    if expected.ball < 0.05 and expected.cube_root < 0.005:  # both are printed as 0
        return ["none: a measured material"]
    words = [*expected.words, "90 % of errors below twice these"]
    return words + [f"coarse: known from {materials} materials"] * (materials < COARSE_BELOW)


def of_prediction(
    is_extrapolation: bool,
    found: Plausibility,
    residual: float = 0.0,
    why: str = "far from all materials",
    measured: BRDF | None = None,
) -> tuple[str, ...]:
    """Of a prediction: whether, and why, the data do not support it, measurements on it, the largest difference over
    bands between the requested reflectance and the one reached, and the material that it is meant to be.
    """
    diagnostics = []
    if is_extrapolation:
        diagnostics.append(f"not supported by the data: {why}; choose a latent nearer to the materials")
    if found.negative_share > MOST_NEGATIVE:
        diagnostics.append(
            f"{100.0 * found.negative_share:.2g} % of the values were negative; the data do not support this point"
        )
    if found.max_albedo > MOST_ALBEDO:
        at = found.albedo_incidence_deg
        words = f"not energy-conserving: albedo {found.max_albedo:.2f} at {at:.0f} degrees"
        if measured is not None:
            words += f"; the measured file has {albedo_at(measured, (at,))[0]:.2f}"
        diagnostics.append(f"{words}; a physical file has at most 1")
    if found.reciprocity_error > MOST_NON_RECIPROCAL:
        diagnostics.append(
            f"not reciprocal: f(wi, wo) and f(wo, wi) differ by {100.0 * found.reciprocity_error:.0f} %; "
            "a physical file takes their mean"
        )
    if found.highlight_valley > MOST_VALLEY:
        diagnostics.append(
            f"dark hole or ring near the mirror direction: {100.0 * found.highlight_valley:.0f} % below both "
            "sides (measured materials: at most 4 %)"
        )
    if residual > MOST_RESIDUAL:
        diagnostics.append(
            f"requested reflectance cannot be reached at this structure: error up to {residual:.2f}"
        )
    return tuple(diagnostics)


def of_measured(found: Plausibility, measured: BRDF | None = None) -> tuple[str, ...]:
    """Of a measured material at its own place, by measurements on it, or on the file that it was written to."""
    sound = replace(found, negative_share=0.0, highlight_valley=0.0)
    diagnostics = list(of_prediction(False, sound, measured=measured))
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


def of_projection(before: Plausibility, found: Plausibility, change: Errors[float]) -> tuple[str, ...]:
    """Of a file that was projected to be physical, by measurements without and with the projection."""
    changed = (
        f"made physical: largest albedo {before.max_albedo:.2f} to {found.max_albedo:.2f}, reciprocity error "
        f"{100.0 * before.reciprocity_error:.0f} to {100.0 * found.reciprocity_error:.0f} %; changed by "
        f"{change.ball:.1f} CIEDE2000 of the ball, {100.0 * change.cube_root:.0f} % in cube roots",
    )
    if found.reciprocity_error <= RECIPROCITY_ERROR:
        return changed
    return (
        *changed,
        f"not reciprocal: the file's f(wi, wo) and f(wo, wi) still differ by {100.0 * found.reciprocity_error:.0f} %, "
        f"expected at most {100.0 * RECIPROCITY_ERROR:.0f} %; write a finer grid and more incidences",
    )


def of_unmeasured(share: float) -> tuple[str, ...]:
    """Of cells that were not measured, as a share of those that should hold something."""
    if share <= MOST_UNMEASURED:
        return ()
    return (
        f"{100.0 * share:.0f} % of the cells were not measured, but filled from neighbours; see `manifold info`",
    )


def of_embedding(errors: Errors[float]) -> tuple[str, ...]:
    """Of an embedded material, by the errors of its reconstruction."""
    if errors.linear <= MOST_EMBEDDING_ERROR and errors.ball <= MOST_EMBEDDING_BALL:
        return ()
    return (
        f"reconstruction error {errors.linear:.2f}, {errors.ball:.1f} CIEDE2000 of the ball: outside the manifold; "
        "import materials like it and embed again",
    )
