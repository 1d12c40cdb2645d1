"""Writes predictions at points on a map as RGL files, with diagnostics."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from manifold import __version__
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import mirror_difference, plausibility_of_file
from manifold.brdf.unmeasured_cells import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.core.records import BsdfFile
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource, place_of, read_measured
from manifold.io_rgl import material_name, write_bsdf
from manifold.model.colours import NEAREST, UNCHOSEN, ChosenColour, ColourChoice
from manifold.model.comparison import brdf_errors
from manifold.model.diagnostics import DiagnosedPrediction, diagnose, diagnose_file
from manifold.model.manifold import Manifold, load_model
from manifold.model.output_file import (
    DEFAULT_OPTIONS,
    FINE_OPTIONS,
    OutputOptions,
    WrittenFile,
    require_bsdf_output,
    write_checked,
)
from manifold.model.places import Place, PlaceLike
from manifold.model.prediction import ClippedBRDF

if TYPE_CHECKING:
    from manifold.estimate.attributes import Adjusted, Attributes

_RECOATED = "the coat was changed to reach the gloss; the expected error does not include this change"


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
    """Predict the material at a point on the map, and write it as an RGL file.

    A file, or a step of a walk, is not predicted from the map: colour and gloss edit its own values, on grids at
    least as fine as `FINE_OPTIONS`. Without such edits, a file is written unchanged.

    Args:
        model: a fitted manifold, or the path of one.
        latent: Q coordinates, another point, or a measured material; a material of the model is predicted at its
            latent.
        output: the file to write; the material is named after it.
        library: path of the model's library, if the library was moved.
        colour: given colour of the prediction; by default its colour is blended.
        attributes: requested gloss and colour; see `attributes.adjust`.
        options: options of the file.

    Raises:
        UsageError: the name of the output does not end in `.bsdf`, the file cannot be written, or `strict` is set
            and its albedo would exceed 1.05.
        LatentError: the latent does not have Q finite coordinates.
    """
    output = Path(output)
    require_bsdf_output(output)
    model = load_model(model, library)
    if isinstance(latent, FileSource) or (
        isinstance(latent, LibrarySource) and latent.name not in model.names
    ):
        made = _of_file(model, latent, colour, attributes)
    else:
        made = _of_place(model, place_of(latent, model), colour, attributes)
    if made.adjusted is not None:
        made.adjusted.warn()
    start = time.perf_counter()
    clipped = ClippedBRDF(made.brdf)
    written = _write(model, made, clipped, output, options)
    assert written.file is not None  # a refusal is an error
    read_back = MeasuredBRDF(fill_unmeasured(written.file))
    difference = mirror_difference(made.brdf, read_back)
    seconds = time.perf_counter() - start
    return replace(
        _diagnose(model, made, written, clipped.clipped_share, read_back),
        path=output,
        is_physical=options.physical,
        clipped_share=clipped.clipped_share,
        mirror_difference=difference,
        seconds=seconds,
    )


@dataclass(frozen=True, eq=False)
class _Made:
    """A material before it is written.

    Attributes:
        place: None of a file, which keeps its own values.
        before: the material before its attributes were changed.
        own: of edited values, and of a file's, the name of what they are from; empty where the map predicts.
        file: the file, if it is one.
        unmeasured: share of a file's cells that were not measured.
    """

    place: Place | None
    brdf: BRDF
    before: BRDF
    chosen: ChosenColour
    adjusted: Adjusted | None = None
    is_recoated: bool = False
    own: str = ""
    file: BsdfFile | None = None
    unmeasured: float = 0.0

    @property
    def is_unchanged(self) -> bool:
        """Whether the prediction is a file whose values are not changed."""
        return self.file is not None and self.brdf is self.before

    def with_attributes(self, of_colour: Attributes | None, of_coat: Attributes) -> _Made:
        """Edit the own values: the colour unless it was changed on the map, and the coat."""
        from manifold.estimate.attributes import by_angle  # which load optimisers
        from manifold.estimate.coat import with_gloss
        from manifold.estimate.edits import own_values

        brdf, adjusted = self.brdf, self.adjusted
        if of_colour is not None:
            brdf, adjusted = own_values(brdf, of_colour)
        assert adjusted is not None
        if of_coat:
            units = of_coat.values(brdf)
            brdf = with_gloss(brdf, by_angle(units))
            adjusted = adjusted.reached_by(brdf, units)
        chosen = replace(self.chosen, words=str(adjusted))
        return replace(self, brdf=brdf, adjusted=adjusted, chosen=chosen, is_recoated=bool(of_coat))


def _of_file(
    model: Manifold, source: FileSource | LibrarySource, colour: ColourChoice, attributes: Attributes | None
) -> _Made:
    """Return a file's material, with its colour and gloss changed if asked for."""
    file = read_measured(source)
    cells = unmeasured_cells(file)
    before: BRDF = MeasuredBRDF(fill_unmeasured(file, cells))
    made = _Made(
        None, before, before, UNCHOSEN, own=str(source), file=file, unmeasured=unmeasured_share(file, cells)
    )
    if colour != NEAREST:
        from manifold.estimate.edits import in_colour

        brdf, words, residual = in_colour(model, before, colour)
        made = replace(made, brdf=brdf, chosen=ChosenColour(None, words, residual))
    return made if attributes is None else made.with_attributes(*attributes.split())


def _of_place(model: Manifold, place: Place, colour: ColourChoice, attributes: Attributes | None) -> _Made:
    """Return the prediction at a point, with another colour and gloss if asked for."""
    if colour != NEAREST or place.walk is not None:
        model.prepare()
    chosen = model.choose_colour(place, colour)
    brdf: BRDF = model.predict(place, chosen.colours).turned(place.rotation_rad)
    made = _Made(place, brdf, brdf, chosen)
    if attributes is None:
        return made
    on_map, of_coat = attributes.split()
    if place.is_step(chosen.colours):
        return replace(made, own=f"the step {place.walk_in_words}").with_attributes(on_map, of_coat)
    from manifold.estimate.attributes import adjust

    adjusted = adjust(model, place, on_map, colour)
    assert adjusted.place is not None
    of_material = model.space.training_index(place.latent, chosen.colours)
    if of_coat and not on_map and of_material is not None:
        made = replace(made, own=model.names[of_material])
    residual = 0.0 if on_map else chosen.residual  # `adjust` states how far it missed the values on the map
    chosen = ChosenColour(adjusted.colours, str(adjusted), residual)
    brdf = model.predict(adjusted.place, chosen.colours).turned(place.rotation_rad)
    made = replace(made, place=adjusted.place, brdf=brdf, chosen=chosen, adjusted=adjusted)
    return made.with_attributes(None, of_coat)


def _write(
    model: Manifold, made: _Made, clipped: ClippedBRDF, output: Path, options: OutputOptions
) -> WrittenFile:
    """Write a material: an unchanged file as it is, an edited one on grids at least as fine as `FINE_OPTIONS`."""
    if made.file is not None and made.is_unchanged and options == DEFAULT_OPTIONS:
        file = replace(made.file, name=material_name(output))
        write_bsdf(output, file)
        return WrittenFile(plausibility_of_file(file), file)
    if made.file is not None:
        options = replace(
            options,
            resolution=max(options.resolution, FINE_OPTIONS.resolution),
            incidences=max(options.incidences, FINE_OPTIONS.incidences),
        )
    expected = None
    if made.place is not None and not made.own:
        expected = model.expected_error(made.place, made.chosen.colours)
    return write_checked(
        output, clipped, options, description=_describe(model, made, options.physical),
        remedy="make it physical, write more incidences",
        expected_error=None if expected is None else expected.cube_root,
    )  # fmt: skip


def _diagnose(
    model: Manifold, made: _Made, written: WrittenFile, clipped_share: float, read_back: BRDF
) -> DiagnosedPrediction:
    """Return the diagnosis of a written material: how far an edit changed it, or the expected errors of the map."""
    found, adjusted = (written.plausibility, clipped_share), made.adjusted
    if made.place is None:
        prediction = diagnose_file(made.own, made.brdf, made.chosen, *found, made.unmeasured)
    else:
        prediction = diagnose(model, made.place, made.brdf, made.chosen, *found, is_recoated=made.is_recoated)
    notes = prediction.diagnostics + written.projection
    if made.own:
        change = brdf_errors(made.before, read_back)
        prediction = replace(
            prediction, own=made.own, change=change, expected=None, expected_in_chosen_colour=None
        )
    elif prediction.expected is not None:
        prediction = replace(prediction, expected=written.expected(prediction.expected))
    if adjusted is None:
        return replace(prediction, diagnostics=notes)
    recoated = (_RECOATED,) * (made.is_recoated and not made.own)
    notes = (*adjusted.shortfalls, *notes, *recoated)
    return replace(prediction, diagnostics=notes, attributes=adjusted.to_json())


def _describe(model: Manifold, made: _Made, physical: bool) -> str:
    """Return the description in a predicted file."""
    place, chosen = made.place, made.chosen
    origin = (
        "a synthetic corpus" if model.materials.is_synthetic else f"{len(model.names)} measured materials"
    )
    how = (f", colour {chosen.words}" if chosen.words else "") + ", projected to be physical" * physical
    if place is None:
        return f"Predicted from {made.own}{how}{',' * bool(how)} by manifold {__version__}"
    at = f"at latent ({', '.join(model.space.printed(place.latent))})"
    if place.is_step(chosen.colours):
        at = f"at a step {place.walk_in_words}"
    return f"Predicted {at}{how}{',' * bool(how)} from {origin} by manifold {__version__}"
