"""Diagnostics of a prediction or an embedding, as sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manifold import __version__
from manifold.brdf.consistency import MOST_NEGATIVE
from manifold.brdf.interface import BRDF
from manifold.brdf.physical import RECIPROCITY_ERROR
from manifold.brdf.plausibility import Plausibility, albedo_at, plausibility
from manifold.core.judged_lights import BALL
from manifold.core.metrics import EXPECTED_BALL, Errors
from manifold.core.names import exceeds, percent
from manifold.core.records import Array
from manifold.core.results import Result, derived, entry
from manifold.model.blending import widest_gap
from manifold.model.colours import NEAREST, UNCHOSEN, ChosenColour, ColourChoice
from manifold.model.expected_error import BELOW_TWICE, COARSE_BELOW, NOT_CALIBRATED
from manifold.model.gplvm_space import GplvmSpace

if TYPE_CHECKING:
    from manifold.model.manifold import Manifold, Posterior
    from manifold.model.places import Place, PlaceLike

AT_A_MATERIAL = "none, because a measured material lies there"
"""Text in place of an expected error at a measured material."""

_LEFT_WALK = (
    "not the step of the walk, but the prediction on the line between both materials on the map, in the given colour; "
    "--lightness, --chroma and --hue change the colour of the step itself"
)
SHOWN_WEIGHT = 0.005
"""Smallest weight that is printed, with two decimals."""

MOST_ALBEDO = 1.05  # measured materials reach a little above 1 too
MOST_NON_RECIPROCAL = 0.5  # relative; measured materials reach 0.3, mirrors more
MOST_VALLEY = 0.1  # depth of a valley over the values beside it; measured materials reach 0.04
MOST_RESIDUAL = 0.02  # difference between reflectances
MOST_UNMEASURED = 0.01  # share of the cells that should hold something
MOST_EMBEDDING_ERROR = 0.5  # relative: half of the material is not reconstructed
MOST_EMBEDDING_BALL = 5.0  # CIEDE2000: an observer sees two different colours (Mokrzycki & Tatol 2011)


def _expected_ball(content: Mapping[str, Any]) -> float | None:
    """Return the expected error of the ball that the row of a prediction states first, given its JSON."""
    expected = content["expected_in_chosen_colour"] or content["expected"]
    return None if expected is None else float(expected["ball"])


@dataclass(frozen=True, kw_only=True, eq=False)
class DiagnosedPrediction(Result):
    """A predicted material, with its expected error and diagnostics.

    Attributes:
        latent: latent of the prediction, shape (Q,); None for a step of a walk, which uses no latent.
        coordinates: the latent as text, with the digits that reproduce the prediction.
        walk: text with the two materials and t of a step of a walk; None for other predictions.
        own: the file, walk step or material whose values are used, possibly edited; None if the map predicts.
        change: errors of the written file with respect to `own`; None if `own` is None.
        colour: text that says where the colour comes from; None if the latent determines it.
        reflectance_residual: largest difference, over the bands, between the given and the reached reflectance.
        weights: the materials with the largest weights, by magnitude, in this colour; empty for a step of a walk.
        nearest: the three nearest materials with their distances; empty for a step of a walk.
        materials: number of materials of the model, on whose leave-one-out errors the expected errors are based.
        expected: expected error of an unknown material at this latent, with the given colour if there is one; None if
            the model is not calibrated, for a latent that the data do not support, and for a step of a walk.
        posterior: standard deviation of the Gaussian process at the latent, with its unit; None for maps of blends
            and for a step of a walk.
        expected_in_chosen_colour: expected error if the colour were given; None unless the colour is blended.
        is_extrapolation: whether the latent is not supported by the data.
        plausibility: physical plausibility of the written file or, without a file, of the prediction.
        diagnostics: defects found, as sentences.
        attributes: requested and reached attributes as plain values; None if none were requested.
        path: path of the written file; None without a file.
        is_physical: whether the file was made non-negative, reciprocal and energy-conserving.
        clipped_share: share of the predicted values that were negative and are zero in the file.
        mirror_difference: difference of the file from the prediction near mirror directions, see
            `plausibility.mirror_difference`; None without a file.
        seconds: time for evaluating, checking and writing, without loading the library.
    """

    brdf: BRDF
    change: Errors[float] | None = field(
        default=None,
        metadata=entry(
            row="difference", words=lambda result: f"{result.change.ball:.1f} {BALL}, from {result.own}"
        ),
    )
    own: str | None = field(default=None, metadata=entry())
    latent: Array | None = field(metadata=entry())
    coordinates: tuple[str, ...] = field(metadata=entry())
    walk: str | None = field(metadata=entry())
    colour: str | None = field(metadata=entry(columns={"colour": ()}))
    reflectance_residual: float = field(metadata=entry())
    weights: list[tuple[str, float]] = field(metadata=entry())

    @property
    def is_file(self) -> bool:
        """Return whether the values are taken from a file, which has no point on the map."""
        return self.latent is None and self.walk is None

    @property
    @derived(row="point", json=False)
    def place_in_words(self) -> str:
        """Return lines of text that state the point, and where the colour comes from."""
        place = f"{self.walk}, a step of a walk" if self.walk is not None else ",".join(self.coordinates)
        if self.is_file:
            place = f"{self.own}, with its own values (`manifold locate` finds its point on the map)"
        return place if self.colour is None else f"{place}; colour {self.colour}"

    @property
    @derived(row="expected error", json=False)
    def expected_in_words(self) -> tuple[str | list[str], ...]:
        """Return lines of text with the expected errors of the prediction in its colour, or why there are none."""
        if self.walk is not None:
            return ("none: a step of a walk has no point on the map",)
        if self.own is not None:
            what = "the material itself" if self.attributes is None and self.colour is None else "the change"
            return (f"none, because the map is not used for {what}",)
        if self.is_extrapolation:
            return ("unknown: not supported by the data, see note",)
        if self.expected_in_chosen_colour is None:
            return in_words(self.expected, self.materials)
        return in_words(self.expected_in_chosen_colour, self.materials, "of a material of this colour: ")

    @property
    @derived(row="unknown material", json=False)
    def unknown_in_words(self) -> list[str]:
        """Return lines of text that state the expected error for a material at this point whose colour is not given."""
        if self.expected_in_chosen_colour is None or self.expected is None:
            return []
        first, *others = self.expected.words
        return [f"located here, its colour not given: {first}", *others]

    @property
    @derived(row="made of", json=False)
    def weights_in_words(self) -> list[str]:
        """Return lines of text that list the materials with the largest weights."""
        shown = [pair for pair in self.weights if abs(pair[1]) >= SHOWN_WEIGHT] or self.weights[:1]
        return [f"{name} {weight:.2f}" for name, weight in shown]

    nearest: list[tuple[str, float]] = field(
        metadata=entry(
            row="nearest",
            is_detail=True,
            words=lambda result: [f"{name} ({distance:.2f})" for name, distance in result.nearest],
        )
    )
    materials: int = field(metadata=entry())
    expected: Errors[Array] | None = field(metadata=entry(columns={EXPECTED_BALL: _expected_ball}))
    expected_in_chosen_colour: Errors[Array] | None = field(metadata=entry())
    posterior: Posterior | None = field(
        default=None,
        metadata=entry(
            row="posterior standard deviation",
            words=lambda result: result.posterior.words,
            json=lambda result: None if result.posterior is None else result.posterior.to_json(),
        ),
    )
    is_extrapolation: bool = field(metadata=entry())

    @property
    @derived(
        row="reciprocity error", words=lambda result: percent(result.reciprocity_error, 2), is_detail=True, json=False
    )  # fmt: skip
    def reciprocity_error(self) -> float:
        """Return the reciprocity error; see `Plausibility`."""
        return self.plausibility.reciprocity_error

    plausibility: Plausibility = field(
        metadata=entry(row="largest albedo", words="{.max_albedo:.3f}", is_detail=True)
    )
    attributes: dict[str, Any] | None = field(default=None, metadata=entry())
    path: Path | None = field(default=None, metadata=entry())
    is_physical: bool = field(default=False, metadata=entry())
    clipped_share: float = field(default=0.0, metadata=entry())
    mirror_difference: float | None = field(
        default=None,
        metadata=entry(
            row="file",
            is_detail=True,
            words=lambda result: (
                f"differs from the prediction by at most {percent(result.mirror_difference, 1)} "
                "within 5 degrees of mirror directions"
            ),
        ),
    )
    diagnostics: tuple[str, ...] = field(metadata=entry(row="diagnostics", is_detail=True))
    seconds: float = field(default=0.0, metadata=entry())

    def to_json(self) -> dict[str, Any]:
        """Return plain values for JSON.

        If a file was written, they include the program's version and values of the file.
        """
        absent = {
            name for name in ("attributes", "posterior", "own", "change") if getattr(self, name) is None
        }
        if self.path is None:
            absent |= {"path", "is_physical", "clipped_share", "mirror_difference", "seconds"}
        program = {} if self.path is None else {"program": f"manifold {__version__}"}
        return program | {name: value for name, value in super().to_json().items() if name not in absent}


def predict_and_diagnose(
    model: Manifold, x: PlaceLike, choice: ColourChoice = NEAREST
) -> DiagnosedPrediction:
    """Return the prediction at a point, in a given or blended colour, with its diagnostics."""
    place = model.place(x)
    chosen = model.choose_colour(place, choice)
    return diagnose(model, place, model.predict(place, chosen.colours), chosen)


def diagnose_file(
    name: str, brdf: BRDF, chosen: ChosenColour, found: Plausibility, negative_share: float, unmeasured: float
) -> DiagnosedPrediction:
    """Return diagnostics of the values of a file, which may be edited.

    `negative_share` is the share of negative values before they were set to 0, `unmeasured` the share of cells that
    were not measured.
    """
    measured = replace(found, negative_share=negative_share)
    return DiagnosedPrediction(
        brdf=brdf, own=name, latent=None, coordinates=(), walk=None, colour=chosen.words,
        reflectance_residual=chosen.residual, weights=[], nearest=[], materials=0, expected=None,
        expected_in_chosen_colour=None, is_extrapolation=False, plausibility=found,
        diagnostics=of_prediction(False, measured, chosen.residual) + of_unmeasured(unmeasured),
    )  # fmt: skip


def diagnose(
    model: Manifold,
    place: Place,
    brdf: BRDF,
    chosen: ChosenColour = UNCHOSEN,
    found: Plausibility | None = None,
    negative_share: float | None = None,
    *,
    is_recoated: bool = False,
) -> DiagnosedPrediction:
    """Return diagnostics and expected error of a prediction at a point.

    `found` is the plausibility of the written file, and `negative_share` the share of negative values before they
    were set to 0. If they are None, they are measured on the prediction. `is_recoated` says that the coat was changed,
    so that the values are not those of a measured material.
    """
    colours, latent = chosen.colours, place.latent
    found = plausibility(brdf) if found is None else found
    is_step = place.is_step(colours)
    is_extrapolation = bool(model.is_extrapolation(place, colours))
    measured = found if negative_share is None else replace(found, negative_share=negative_share)
    is_measured = not is_step and model.space.training_index(latent, colours) is not None
    is_blended = colours is None and model.space.takes_colours and not is_step and not is_measured
    in_chosen_colour = model.left_out.expected(latent) if is_blended and model.left_out is not None else None
    if is_measured and not is_recoated:
        sentences = of_measured(measured, brdf)
    else:
        why = _reason(model, place) if is_extrapolation else ""
        sentences = of_prediction(is_extrapolation, measured, chosen.residual, why)
        if place.walk is not None and not is_step:
            sentences += (_LEFT_WALK,)
    return DiagnosedPrediction(
        brdf=brdf,
        latent=None if is_step else latent,
        coordinates=() if is_step else model.space.printed(latent),
        walk=place.walk_in_words if is_step else None,
        colour=chosen.words,
        reflectance_residual=chosen.residual,
        weights=[] if is_step else model.largest_weights(place, 5, colours),
        nearest=[] if is_step else model.nearest(place, 3),
        materials=len(model.names),
        expected=None if is_extrapolation else model.expected_error(place, colours),
        expected_in_chosen_colour=None if is_extrapolation else in_chosen_colour,
        posterior=model.posterior(place) if isinstance(model.space, GplvmSpace) and not is_step else None,
        is_extrapolation=is_extrapolation,
        plausibility=found,
        diagnostics=sentences + of_unmeasured(model.unmeasured_share(place, colours)) + model.notes,
    )


def _reason(model: Manifold, place: Place) -> str:
    """Return the reason why the data do not support a point: see `LeftOut.is_unsupported`."""
    distance, left_out = model.nearest(place)[0][1], model.left_out
    if left_out is None or distance > widest_gap(left_out.space.X):
        return f"the nearest material is {distance:.1f} length scales away"
    return f"left-out materials near it differ by about {left_out.expected(place.latent).ball:.0f} {BALL}"


def in_words(expected: Errors[Array] | None, materials: int, of: str = "") -> tuple[str | list[str], ...]:
    """Return lines of text that state an expected error of a model with `materials` materials.

    The first line begins with `of`.
    """
    if expected is None:
        return (f"unknown: {'; '.join(NOT_CALIBRATED)}",)
    if expected.ball < 0.05 and expected.cube_root < 0.005:  # both are printed as 0
        return (AT_A_MATERIAL,)
    first, *others = expected.words
    lines: list[str | list[str]] = [[of + first, *others]]
    lines.append(f"{percent(BELOW_TWICE)} of true errors are below twice this value")
    if materials < COARSE_BELOW:
        lines.append(f"uncertain by a factor of three: the model has only {materials} materials")
    return tuple(lines)


def of_prediction(
    is_extrapolation: bool,
    found: Plausibility,
    residual: float = 0.0,
    why: str = "far from all materials",
    measured: BRDF | None = None,
) -> tuple[str, ...]:
    """Return diagnostics of a prediction: lack of support, physical faults, and a colour that was not reached.

    `residual` is the largest difference, over the bands, between given and reached reflectance; `measured` is the
    material that the prediction should reproduce.
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
            f"requested reflectance cannot be reached at this point of the map: error up to {residual:.2f}"
        )
    return tuple(diagnostics)


def of_measured(found: Plausibility, measured: BRDF | None = None) -> tuple[str, ...]:
    """Return diagnostics of a measured material at its own latent, from measurements on it or on its file."""
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
    """Return diagnostics of a file that was made physical, from measurements before and after."""
    changed = (
        f"made physical: largest albedo {before.max_albedo:.2f} to {found.max_albedo:.2f}, reciprocity error "
        f"{100.0 * before.reciprocity_error:.0f} to {100.0 * found.reciprocity_error:.0f} %; changed by "
        f"{change.ball:.1f} {BALL}, {100.0 * change.cube_root:.0f} % in cube roots",
    )
    if not exceeds(100.0 * found.reciprocity_error, 100.0 * RECIPROCITY_ERROR, 0):
        return changed
    return (
        *changed,
        f"not reciprocal: the file's f(wi, wo) and f(wo, wi) still differ by {100.0 * found.reciprocity_error:.0f} %, "
        f"expected at most {100.0 * RECIPROCITY_ERROR:.0f} %; write a finer grid and more incidences",
    )


def of_unmeasured(share: float) -> tuple[str, ...]:
    """Return a diagnostic if many of the cells above the horizon, given as their share, were not measured."""
    if share <= MOST_UNMEASURED:
        return ()
    return (
        f"{100.0 * share:.0f} % of the cells were not measured, but filled from neighbours; see `manifold info`",
    )


def of_embedding(errors: Errors[float]) -> tuple[str, ...]:
    """Return diagnostics of an embedded material, from the errors of its reconstruction."""
    if errors.linear <= MOST_EMBEDDING_ERROR and errors.ball <= MOST_EMBEDDING_BALL:
        return ()
    return (
        f"reconstruction error {errors.linear:.2f}, {errors.ball:.1f} {BALL}: outside the manifold; "
        "import materials like it and embed again",
    )
