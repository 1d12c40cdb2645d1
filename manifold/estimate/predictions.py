"""Predictions at places: RGL files with diagnostics."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manifold import __version__
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import mirror_difference
from manifold.estimate.sources import MaterialSource, place_of
from manifold.model.colours import NEAREST, ChosenColour, ColourChoice
from manifold.model.diagnostics import DiagnosedPrediction, diagnose
from manifold.model.manifold import Manifold, load_model
from manifold.model.output_file import (
    DEFAULT_OPTIONS,
    OutputOptions,
    require_bsdf_output,
    write_checked,
)
from manifold.model.places import Place, PlaceLike
from manifold.model.prediction import ClippedBRDF

if TYPE_CHECKING:
    from manifold.estimate.attributes import Attributes

_RECOATED = "the coat was changed to reach the gloss; the expected error is that before this change"


def predict(
    model: Manifold | Path | str,
    latent: PlaceLike | MaterialSource,
    output: Path | str,
    *,
    library: Path | str | None = None,
    colour: ColourChoice = NEAREST,
    attributes: Attributes | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> DiagnosedPrediction:
    """Predict the material at a latent and write it as an RGL file.

    Args:
        model: a fitted manifold, or the path of one.
        latent: Q coordinates, another place, or a material, which is located.
        output: the file to write; its name becomes the material's.
        library: where the model's library is now, if not where the model remembers it.
        colour: another than that of the place.
        attributes: gloss and colour that the material should have instead of its own; see `attributes.adjust`.
        options: of the file.

    Raises:
        UsageError: the name of the output does not end in `.bsdf`, the file cannot be written, or `strict` is set
            and its albedo would exceed 1.05.
        LatentError: the latent does not have Q finite coordinates.
    """
    output = Path(output)
    require_bsdf_output(output)
    model = load_model(model, library)
    place = place_of(latent, model)
    if colour != NEAREST or place.walk is not None:
        model.prepare()
    if attributes is None:
        adjusted, chosen = None, model.choose_colour(place, colour)
    else:
        from manifold.estimate.attributes import adjust, by_angle  # which load optimisers

        on_map, of_coat = attributes.split()
        adjusted = adjust(model, place, on_map, colour)
        place, chosen = adjusted.place, ChosenColour(adjusted.colours, str(adjusted), 0.0)
    brdf: BRDF = model.predict(place, chosen.colours).turned(place.rotation_rad)
    if adjusted is not None and of_coat:
        from manifold.estimate.coat import with_gloss

        units = of_coat.values(brdf)
        brdf = with_gloss(brdf, by_angle(units))
        adjusted = adjusted.reached_by(brdf, units)
        chosen = replace(chosen, words=str(adjusted))
    if adjusted is not None:
        adjusted.warn()
    start = time.perf_counter()
    clipped = ClippedBRDF(brdf)
    description = _describe(model, place, chosen, options.physical)
    remedy = "make it physical, write more incidences"
    of_place = model.expected_error(place, chosen.colours)
    written = write_checked(
        output, clipped, options, description=description, remedy=remedy,
        expected_error=None if of_place is None else of_place.cube_root,
    )  # fmt: skip
    assert written.file is not None  # a refusal is an error
    difference = mirror_difference(brdf, MeasuredBRDF(written.file))
    seconds = time.perf_counter() - start
    prediction = diagnose(model, place, brdf, chosen, written.plausibility, clipped.clipped_share)
    if prediction.expected is not None:
        prediction = replace(prediction, expected=written.expected(prediction.expected))
    turned = f"turned by {np.rad2deg(place.rotation_rad):.1f} degrees, as the sample lay"
    prediction = replace(
        prediction,
        diagnostics=prediction.diagnostics + written.projection + (turned,) * bool(place.rotation_rad),
    )
    if adjusted is not None:
        prediction = replace(
            prediction,
            diagnostics=prediction.diagnostics + adjusted.shortfalls + (_RECOATED,) * bool(of_coat),
            attributes=adjusted.to_json(),
        )
    return replace(
        prediction,
        path=output,
        is_physical=options.physical,
        clipped_share=clipped.clipped_share,
        mirror_difference=difference,
        seconds=seconds,
    )


def _describe(model: Manifold, place: Place, chosen: ChosenColour, physical: bool) -> str:
    """Return the description in a predicted file."""
    origin = (
        "a synthetic corpus" if model.materials.is_synthetic else f"{len(model.names)} measured materials"
    )
    at = f"at latent ({', '.join(model.space.printed(place.latent))})"
    if place.is_step(chosen.colours):
        at = f"at a step {place.walk_in_words}"
    how = (f", colour {chosen.words}" if chosen.words else "") + ", projected to be physical" * physical
    return f"Predicted {at}{how}{',' * bool(how)} from {origin} by manifold {__version__}"
