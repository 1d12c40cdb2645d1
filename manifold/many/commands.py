"""Defines the commands for many materials: for each, the function that `batch` calls for one material."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from manifold.colour.correction import read_correction
from manifold.convert import conversion
from manifold.convert.source import open_source
from manifold.convert.targets import Options
from manifold.core import shipped
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.judged_lights import BALL, BALL_COLUMN
from manifold.core.metrics import EXPECTED_BALL
from manifold.core.results import Columns, placed
from manifold.estimate import coat, completions, descriptions, instruments, predictions, reports
from manifold.estimate.attributes import readings_of_colour
from manifold.estimate.coat import ColourSample
from manifold.estimate.inputs import Input, Sample
from manifold.estimate.source_files import read_source
from manifold.estimate.sources import PlaceSource
from manifold.library.identity import file_sha256
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.many.batch import (
    LAB_UNDER,
    MEASURED,
    PREDICTED,
    Batch,
    BatchCommand,
    Content,
    appearance,
    appearance_columns,
    ball_path,
    measured_appearance,
)
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.model.location import Located, Reconstruction
from manifold.model.manifold import load_model
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions
from manifold.pictures import renders as pictures
from manifold.registries import CONVERTED
from manifold.render import images
from manifold.render.render import RenderSettings, require_d65
from manifold.surface.files import SurfaceFiles, require_textured, write_surface
from manifold.surface.lamp_pictures import read_workbook


def completions_of(
    library: Path, *, correction: Path | None = None, count: int = 0, instrument: str | None = None,
    options: OutputOptions, report: Path | None = None,
) -> BatchCommand[Sample]:  # fmt: skip
    """Return the batch command that completes the samples of `inputs.find_samples`; see `completions.complete`.

    `correction` is a file of `manifold calibrate`. `report` is an index page; the reports of the samples lie in a
    folder beside it.
    """
    how = {
        "library": Library(library).content_hash,
        "count": count,
        "instrument": instrument,
        **asdict(options),
    }
    pages = None
    if report is not None:
        pages = report.parent / f"{report.stem}_reports"
        how["reports"] = str(pages.absolute())
    if correction is not None:
        read_correction(correction)
        how["correction"] = file_sha256(correction)
    columns: Columns = {"from": lambda content: content.get("from")}
    columns |= placed(completions.Completed.columns(), PREDICTED, before=EXPECTED_BALL)
    make = partial(
        _complete, library=library, correction=correction, count=count, instrument=instrument, options=options,
        pages=pages,
    )  # fmt: skip
    return BatchCommand(
        "completions", make, how, columns=columns, under=EXPECTED_BALL, has_balls=True,
        beside=None if pages is None else partial(_report_of, pages),
        conclude=None if report is None else partial(_list_reports, report),
    )  # fmt: skip


def _report_of(pages: Path, path: Path, content: Content) -> list[Path]:
    return [pages / f"{path.stem}.html"]


def _list_reports(report: Path, completed: Batch[Sample]) -> None:
    pages = f"{report.stem}_reports"
    cards = [
        (
            os.path.relpath(ball_path(outcome.path), report.parent),
            f"{pages}/{outcome.path.stem}.html",
            outcome.name,
            f"expected error {outcome.content['expected']['ball']:.1f} {BALL}",
        )
        for outcome in completed.outcomes
        if outcome.content is not None and (report.parent / pages / f"{outcome.path.stem}.html").is_file()
    ]
    reports.write_index(report, cards)


def _complete(
    sample: Sample, path: Path, *, library: Path, correction: Path | None, count: int, instrument: str | None,
    options: OutputOptions, pages: Path | None,
) -> Content:  # fmt: skip
    readings, learned = instruments.read_sample(sample, correction)
    completed = completions.complete(
        library, readings, path, correction=learned, count=count, instrument=instrument, options=options
    )
    if pages is not None:
        pages.mkdir(parents=True, exist_ok=True)
        reports.write_completion(
            _report_of(pages, path, {})[0], completed, [part for part, _ in sample.parts]
        )
    return completed.to_json() | {"from": ", ".join(part.name for part, _ in sample.parts)} | appearance(path)


def coats(library: Path, *, is_mixture: bool = False, options: OutputOptions) -> BatchCommand[ColourSample]:
    """Return the batch command that makes materials of the colours of `coat.read_colours`; see `coat.complete`.

    With `is_mixture`, and for colours without gloss, materials of the library are mixed instead of using a coat.
    """
    columns = placed(coat.Coated.columns(), PREDICTED, before=EXPECTED_BALL)
    how = {"library": Library(library).content_hash, "mixture": is_mixture, **asdict(options)}
    make = partial(_complete_colour, library=library, is_mixture=is_mixture, options=options)
    return BatchCommand("completions", make, how, columns=columns, under=EXPECTED_BALL, has_balls=True)


def surfaces(
    library: Path, *, size: int, targets: Sequence[str], mm_per_pixel: float | None = None
) -> BatchCommand[Sample]:
    """Return the batch command that makes surfaces of samples in workbooks with pictures; see `make_surface`."""
    columns = PREDICTED | SurfaceFiles.columns()
    require_textured(targets)
    settings: dict[str, Any] = {"size": size, "targets": list(targets), "mm_per_pixel": mm_per_pixel}
    how = {"library": Library(library).content_hash, **settings}
    make = partial(_make_surface, library=library, **settings)
    return BatchCommand(
        "surfaces", make, how, ".json", columns=columns, under="glints", has_balls=True, beside=_textures_of
    )


def _textures_of(path: Path, content: Content) -> list[Path]:
    return [path.parent / name for name in content["files"].values()]


def _make_surface(sample: Sample, path: Path, *, library: Path, **settings: Any) -> Content:
    pictures, readings = read_workbook(*sample.parts[0])
    surface = write_surface(library, pictures, readings, path.parent, name=path.stem, **settings)
    seen = appearance(surface.paths["mean"])
    if "picture" in surface.paths:  # in place of the mean's ball: a plane, and the ball
        strip = images.read_display(surface.paths["picture"])
        side = len(strip)
        images.write_display(
            ball_path(path), np.concatenate([strip[:, side : 2 * side], strip[:, -side:]], axis=1)
        )
    return surface.to_json() | seen


def _complete_colour(
    sample: ColourSample, path: Path, *, library: Path, is_mixture: bool, options: OutputOptions
) -> Content:
    completed: coat.Coated | completions.Completed
    if is_mixture or not sample.gloss:
        readings = readings_of_colour(np.array(sample.lab), sample.gloss, Library(library).bands)
        completed = completions.complete(library, readings, path, options=options)
    else:
        completed = coat.complete(library, sample, path, options=options)
    return completed.to_json() | appearance(path)


def import_outputs(outputs: Batch[Any], library: Path) -> None:
    """Import the files of a batch into a library, replacing materials with the same names."""
    paths = [o.path for o in outputs.outcomes if o.failure is None]
    failed = import_files(library, paths, replace=True).failed if paths else {}
    if failed:
        raise ManifoldError("; ".join(failed.values()))


def predictions_of(
    model: Path, *, library: Path | None = None, options: OutputOptions = DEFAULT_OPTIONS
) -> BatchCommand[Input]:
    """Return the batch command that predicts at the points of `inputs.read_points`; see `predictions.predict`."""
    loaded = load_model(model, library)
    suffix = "_rgb.bsdf" if loaded.bands.is_rgb else "_spec.bsdf"
    columns = _latent_columns(loaded.settings.latent_dim) | DiagnosedPrediction.columns()
    return BatchCommand(
        "predictions", partial(_predict, options=options), asdict(options), suffix, (".bsdf",), columns,
        prepare=loaded.prepare,
    )  # fmt: skip


def _predict(source: Input, path: Path, *, options: OutputOptions) -> Content:
    place = source.source
    assert isinstance(place, PlaceSource)
    model = load_model(place.model, place.library)
    return predictions.predict(model, place.place, path, colour=place.colour, options=options).to_json()


def locations(model: Path, *, library: Path | None, options: OutputOptions) -> BatchCommand[Input]:
    """Return the batch command that locates measured files and writes the predictions; see `descriptions.locate`."""
    loaded = load_model(model, library)
    columns = _latent_columns(loaded.settings.latent_dim)
    columns |= placed(Located.columns(), MEASURED | PREDICTED, before=BALL_COLUMN)
    content_hash = loaded.library.content_hash
    how = {"model": file_sha256(shipped.model_file(model)), "library": content_hash, **asdict(options)}
    make = partial(_locate, model=model, library=library, options=options)
    return BatchCommand(
        "locations", make, how, columns=columns, under=BALL_COLUMN, has_balls=True, is_of_measured=True
    )


def _latent_columns(latent_dim: int) -> Columns:
    """Return one column per coordinate of a latent, in full precision; empty for a step of a walk."""

    def column(k: int) -> Callable[[Content], Any]:
        return lambda content: content["coordinates"][k] if content["coordinates"] else None

    return {f"x{k + 1}": column(k) for k in range(latent_dim)}


def _locate(
    source: Input, path: Path, *, model: Path, library: Path | None, options: OutputOptions
) -> Content:
    loaded = load_model(model, library)
    return _shown(descriptions.locate(loaded, source.source, path, options=options), source, path)


def reconstructions_of(
    library: Path, *, without: tuple[str, ...], numbers: int | None, options: OutputOptions
) -> BatchCommand[Input]:
    """Return the batch command that reconstructs measured files; see `descriptions.reconstruct`."""
    columns = placed(Reconstruction.columns(), MEASURED | PREDICTED, before=BALL_COLUMN)
    used = {"library": Library(library).content_hash, "without": sorted(without), "numbers": numbers}
    make = partial(_reconstruct, library=library, without=without, numbers=numbers, options=options)
    return BatchCommand(
        "reconstructions", make, used | asdict(options), columns=columns, under=BALL_COLUMN, has_balls=True,
        is_of_measured=True,
    )  # fmt: skip


def _reconstruct(source: Input, path: Path, *, library: Path, **how: Any) -> Content:
    return _shown(descriptions.reconstruct(library, source.source, path, **how), source, path)


def _shown(reconstruction: Reconstruction, source: Input, path: Path) -> Content:
    written = {} if reconstruction.refusal is not None else appearance(path)
    return reconstruction.to_json() | measured_appearance(path, read_source(source.source)) | written


def conversions(to: str, *, correction: Path | None = None, options: Options) -> BatchCommand[Input]:
    """Return the batch command that converts files or samples to a format of `CONVERTED`; see `conversion.convert`."""
    target = CONVERTED[to]
    columns = placed(
        conversion.Conversion.columns(), appearance_columns("written") | LAB_UNDER, before="cube root"
    )
    how = {"to": to, **options._asdict()}
    if correction is not None:
        how["correction"] = file_sha256(correction)
    suffix = next(iter(target.suffixes), f".{to}.txt")
    make = partial(_convert, to=to, correction=correction, options=options)
    return BatchCommand("conversions", make, how, suffix, columns=columns, under="cube root", has_balls=True)


def _convert(source: Input, path: Path, *, to: str, correction: Path | None, options: Options) -> Content:
    with conversion.conversion_input([source.source]) as given:
        converted = conversion.convert(
            given, path, to=to, sample=source.sample, correction=correction, options=options
        )
    brdf = open_source([path]).interpolated
    return converted.to_json() | ({} if isinstance(brdf, UsageError) else appearance(path, brdf))


def renders(
    settings: RenderSettings, *, model: Path | None = None, library: Path | None = None, direct: bool = False
) -> BatchCommand[Input]:
    """Return the batch command that renders balls of materials; see `pictures.renders.render`.

    If the materials are points of a table, `model` and `library` apply to all, and no contact sheet is drawn.
    `direct` evaluates predictions from their measured materials while rendering.
    """
    loaded = None if model is None else load_model(model, library)
    if loaded is not None and loaded.bands.is_rgb:
        require_d65(settings.illuminant)
    return BatchCommand(
        "renders", partial(_render, settings=settings, direct=direct),
        pictures.settings_key(settings) | {"direct": direct}, ".png", images.SUFFIXES, pictures.Rendered.columns(),
        has_balls=loaded is None, prepare=None if loaded is None else loaded.prepare,
    )  # fmt: skip


def _render(source: Input, path: Path, *, settings: RenderSettings, direct: bool) -> Content:
    return pictures.render(source.source, path, settings, direct=direct).to_json()
