"""Makes the figures of the commands `map`, `walk` and `slices`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import blank_unmeasured, fill_unmeasured
from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.estimate.source_files import read_source
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource, PlaceSource, place_of
from manifold.model import diagnostics
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.model.manifold import Manifold
from manifold.model.places import Place, PlaceLike, on_line
from manifold.model.walks import Walk
from manifold.pictures import ball_figures, figures, map_figure, slice_figures
from manifold.pictures.slice_figures import ShownBRDF
from manifold.render import backend, fit_json, thumbnails
from manifold.render.fitted_brdf import FittedBRDF


@backend.variant_kept()
def latent_map(
    model: Path,
    output: Path,
    *,
    library: Path | None = None,
    marked: PlaceLike | MaterialSource | None = None,
    colour: ColourChoice = NEAREST,
) -> tuple[DiagnosedPrediction | None, tuple[str, ...]]:
    """Draw the map with a ball per material and the ball of a prediction, or with points if Mitsuba is missing.

    Returns the marked prediction, and notes about omitted balls.
    """
    figures.require_writable(output)
    loaded = Manifold.load(model, library)
    predicted = (
        None if marked is None else diagnostics.predict_and_diagnose(loaded, place_of(marked, loaded), colour)
    )
    if predicted is not None and predicted.walk is not None:
        raise UsageError(
            f"{marked}: a step of a walk, which has no point on the map; mark a material or coordinates, or use "
            "`manifold walk`"
        )
    x = None if predicted is None else predicted.latent
    if not backend.is_available():
        figures.save(map_figure.latent_map(loaded, marked=x), output)
        return predicted, ("rendered balls, because Mitsuba is missing",)
    ball = None if predicted is None else thumbnails.of_material(predicted.brdf)
    balls = thumbnails.of_materials(loaded)
    figures.save(ball_figures.ball_map(loaded, balls, x, ball), output)
    return predicted, ()


@backend.variant_kept()
def walk(
    model: Path,
    start: MaterialSource,
    end: MaterialSource,
    output: Path,
    *,
    steps: int = 7,
    library: Path | None = None,
) -> dict[float, DiagnosedPrediction]:
    """Draw the walk between two materials, and below it predictions from the latents between them on the map.

    Returns the steps of the walk by t. Steps with diagnostics are marked in the picture.
    """
    figures.require_writable(output)
    backend.imported()
    loaded = Manifold.load(model, library)
    t = np.linspace(0.0, 1.0, steps)
    ends = [_end(loaded, source) for source in (start, end)]
    first, last = (place_of(source, loaded).latent for source in (start, end))
    path = Walk.between(*ends)
    methods: list[tuple[str, Callable[[float], BRDF]]] = [
        ("walk", path.at),
        ("path of\nlatents", lambda value: loaded.predict(on_line(first, last, value))),
    ]
    rows: list[tuple[str, list[Array]]] = []
    between: dict[float, DiagnosedPrediction] = {}
    for name, along in methods:
        images: list[Array] = []
        for value in t.tolist():
            with progress.listen(None):
                brdf = along(value)
                images.append(thumbnails.of_material(brdf))
            if not rows and 0.0 < value < 1.0:
                step = Place(on_line(first, last, value), (str(start), str(end), value))
                between[value] = diagnostics.diagnose(loaded, step, brdf)
            done = len(rows) * steps + len(images)
            progress.report(done, len(methods) * steps, f"{name}, t = {value:.2g}".replace("\n", " "))
        rows.append((name, images))
    doubtful = [value in between and bool(between[value].diagnostics) for value in t.tolist()]
    title = figures.in_lines(f"From {start} to {end}", 14 * steps)
    figures.save(ball_figures.walk_strip(title, t.tolist(), rows, doubtful), output)
    return between


def _end(model: Manifold, source: MaterialSource) -> BRDF:
    """Return the BRDF at an end of a walk, its unmeasured cells filled."""
    if isinstance(source, PlaceSource):
        return diagnostics.predict_and_diagnose(model, source.place, source.colour).brdf
    if isinstance(source, LibrarySource) and source.name in model.names:
        return model.materials.filled([source.name])[0]
    brdf = MeasuredBRDF(fill_unmeasured(read_source(source)))
    model.bands.require_same(brdf.bands, str(source))
    return brdf


SliceKind = Literal["angles", "image", "spectra"]


def sources(materials: Sequence[MaterialSource]) -> list[ShownBRDF]:
    """Return the BRDFs that a user names; unmeasured cells of measured ones are NaN.

    If several materials have the same label, they are labelled with the texts that the user gave. Each model is
    opened once.
    """
    found: list[tuple[str, ShownBRDF]] = []
    models: dict[tuple[Path, Path | None], Manifold] = {}
    for material in materials:
        given = str(material)
        if isinstance(material, PlaceSource):
            key = (material.model, material.library)
            if key not in models:
                models[key] = Manifold.load(*key)
            made = diagnostics.predict_and_diagnose(models[key], material.place, material.colour)
            found.append((f"predicted at {given}", ShownBRDF(f"predicted at {given}", made.brdf, made)))
        elif isinstance(material, FileSource) and material.path.suffix == ".json":
            content = fit_json.read(material.path)
            found.append((given, ShownBRDF(f"{content['source']['name']}, fitted", FittedBRDF(content))))
        else:
            file = read_source(material)
            is_told = file.origin in ("measured", file.name)
            label = file.name if is_told else f"{file.name}, {file.origin}"
            found.append((given, ShownBRDF(label, MeasuredBRDF(blank_unmeasured(file)))))
    if not found:
        raise UsageError("no material to draw; give files, materials of a library, or points on a map")
    labels = [source.label for _, source in found]
    return [
        replace(source, label=given) if labels.count(source.label) > 1 else source for given, source in found
    ]


def slices(
    drawn: Sequence[ShownBRDF],
    output: Path,
    *,
    kind: SliceKind = "angles",
    wavelengths_nm: Sequence[float] = (),
) -> dict[str, Any] | None:
    """Draw slices (`angles`), the Rusinkiewicz plane (`image`) or `spectra` of a few BRDFs.

    Returns the drawn values, see `slice_figures.curves`; None for images.
    """
    figures.require_writable(output)
    if kind == "angles":
        figure = slice_figures.angle_slices(drawn, wavelengths_nm)
    elif kind == "image":
        figure = slice_figures.rusinkiewicz_images(drawn)
    else:
        figure = slice_figures.spectra_at(drawn)
    figures.save(figure, output)
    return slice_figures.curves(kind, drawn, wavelengths_nm)
