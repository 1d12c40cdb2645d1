"""Commands for many materials: what each does with one, as tasks of a batch."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from manifold import disk
from manifold.batch import APPEARANCE, Batch, Outcome, Task, appearance, ball_path
from manifold.colour.correction import read_correction
from manifold.convert import conversion
from manifold.convert.source import open_source
from manifold.convert.targets import TARGETS, Options
from manifold.errors import ManifoldError, UsageError
from manifold.estimate import coat, completions, predictions, reports
from manifold.estimate.attributes import readings_of_colour
from manifold.estimate.coat import ColourSample
from manifold.estimate.inputs import Input, Sample
from manifold.library.identity import file_sha256
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.located import Reconstruction
from manifold.model.manifold import load_model
from manifold.model.output_file import OutputOptions
from manifold.pictures import renders
from manifold.render.render import RenderSettings

_ERRORS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "CIEDE2000": lambda content: content["errors"]["ball"],
    "cube root": lambda content: content["errors"]["cube_root"],
    "linear": lambda content: content["errors"]["linear"],
}


def completions_in(folder: Path) -> Batch:
    """Completed samples."""
    columns: dict[str, Callable[[dict[str, Any]], Any]] = {
        "from": lambda content: content.get("from"),
        "instrument": lambda content: content["instrument"],
        "readings": lambda content: content["readings"],
        **APPEARANCE,
        "expected CIEDE2000": lambda content: content["expected"]["ball"],
        "expected cube root": lambda content: content["expected"]["cube_root"],
        "expected linear": lambda content: content["expected"]["linear"],
        "residual": lambda content: content["residual"],
    }
    return Batch(folder, "completions", columns, "expected CIEDE2000", has_balls=True)


def complete_all(
    samples: Sequence[Sample], library: Path, batch: Batch, *, correction: Path | None = None, count: int = 0,
    instrument: str | None = None, options: OutputOptions, workers: Executor | None = None, report: Path | None = None,
) -> list[Outcome[Sample]]:  # fmt: skip
    """Complete samples through a library, each into a `.bsdf` file; see `completions.complete_readings`.

    Args:
        samples: see `samples.find_samples`.
        library: of measured materials.
        batch: see `completions_in`.
        correction: of colours, a file.
        count, instrument, options: as there.
        workers: see `work.run`.
        report: page that lists a report of each, which lie in a folder beside it; None for none.
    Raises: as `Batch.run`; `UsageError` also where the library cannot be used.
    """
    if report is not None:
        disk.require_writable(report)
    pages = None if report is None else report.parent / f"{report.stem}_reports"
    how = {
        "library": Library(library).content_hash,
        "count": count,
        "instrument": instrument,
        **asdict(options),
    }
    if pages is not None:
        how["reports"] = str(pages.absolute())
    if correction is not None:
        read_correction(correction)
        how["correction"] = file_sha256(correction)

    def made_of(sample: Sample) -> dict[str, Any]:
        return how | {
            "parts": [[file_sha256(path), name] for path, name in sample.parts],
            "note": sample.note,
        }

    make = partial(
        _complete, library=library, correction=correction, count=count, instrument=instrument, options=options,
        pages=pages,
    )  # fmt: skip
    todo = [Task(one.name, batch.folder / f"{one.name}.bsdf", one) for one in samples]
    outcomes = batch.run(todo, make, made_of, workers=workers)
    if report is not None and pages is not None:
        _list_reports(report, pages, outcomes)
    return outcomes


def _list_reports(report: Path, pages: Path, outcomes: Sequence[Outcome[Sample]]) -> None:
    cards = [
        (
            os.path.relpath(ball_path(one.path), report.parent),
            f"{pages.name}/{one.path.stem}.html",
            one.name,
            f"expected error of the ball {one.content['expected']['ball']:.1f}",
        )
        for one in outcomes
        if one.content is not None and (pages / f"{one.path.stem}.html").is_file()
    ]
    reports.write_index(report, "Completions", cards)


def _complete(
    sample: Sample, path: Path, *, library: Path, correction: Path | None, count: int, instrument: str | None,
    options: OutputOptions, pages: Path | None,
) -> dict[str, Any]:  # fmt: skip
    readings, learned = completions.read_sample(sample, correction)
    made = completions.complete_readings(
        readings, library, path, correction=learned, count=count, instrument=instrument, options=options
    )
    if pages is not None:
        pages.mkdir(parents=True, exist_ok=True)
        reports.write_completion(pages / f"{path.stem}.html", made, [part for part, _ in sample.parts])
    return made.to_json() | {"from": ", ".join(part.name for part, _ in sample.parts)} | appearance(path)


def coats_in(folder: Path) -> Batch:
    """Colours and gloss made materials."""
    columns: dict[str, Callable[[dict[str, Any]], Any]] = {
        **APPEARANCE,
        "expected CIEDE2000": lambda content: content["expected"]["ball"],
    }
    return Batch(folder, "completions", columns, "expected CIEDE2000", has_balls=True)


def complete_colours(
    samples: Sequence[ColourSample], library: Path, batch: Batch, *, is_mixture: bool = False,
    options: OutputOptions, workers: Executor | None = None,
) -> list[Outcome[ColourSample]]:  # fmt: skip
    """Make materials of colours and gloss, each into a `.bsdf` file; see `coat.complete_colour`.

    Args:
        samples: see `coat.read_colours`.
        library: of measured materials.
        batch: see `coats_in`.
        is_mixture: of the library's materials, as those without gloss always are.
        options: of the files.
        workers: see `work.run`.
    Raises: as `Batch.run`; `UsageError` also where the library cannot be used.
    """
    how = {"library": Library(library).content_hash, "mixture": is_mixture, **asdict(options)}
    make = partial(_complete_colour, library=library, is_mixture=is_mixture, options=options)
    todo = [Task(one.name, batch.folder / f"{one.name}.bsdf", one) for one in samples]
    return batch.run(todo, make, lambda one: how | _plain(one), workers=workers)


def _plain(sample: ColourSample) -> dict[str, Any]:
    return {"lab": list(sample.lab), "gloss": {f"{angle:g}": units for angle, units in sample.gloss.items()}}


def _complete_colour(
    sample: ColourSample, path: Path, *, library: Path, is_mixture: bool, options: OutputOptions
) -> dict[str, Any]:
    made: coat.Coated | completions.Completed
    if is_mixture or not sample.gloss:
        readings = readings_of_colour(np.array(sample.lab), sample.gloss, Library(library).bands)
        made = completions.complete_readings(readings, library, path, options=options)
    else:
        made = coat.complete_colour(sample, library, path, options=options)
    return made.to_json() | appearance(path)


def import_all(outcomes: Sequence[Outcome[Any]], library: Path) -> None:
    """Import the files that were made into a library, in place of others of the same names.

    Raises: as `import_files`; `ManifoldError` where one of them cannot be imported.
    """
    paths = [o.path for o in outcomes if o.failure is None]
    failed = import_files(library, paths, replace=True).failed if paths else {}
    if failed:
        raise ManifoldError("; ".join(failed.values()))


def locations_in(folder: Path) -> Batch:
    """Predictions at the latents of measured files."""
    columns: dict[str, Callable[[dict[str, Any]], Any]] = {
        "latent": lambda content: " ".join(content["coordinates"]),
        "nearest": lambda content: content["nearest"][0][0],
        **APPEARANCE,
        **_ERRORS,
    }
    return Batch(folder, "locations", columns, "CIEDE2000", has_balls=True)


def locate_all(
    sources: Sequence[Input], model: Path, batch: Batch, *, library: Path | None = None, options: OutputOptions,
    workers: Executor | None = None,
) -> list[Outcome[Input]]:  # fmt: skip
    """Find the latents of measured files, and write the predictions there; see `reconstruction.locate`."""
    how = {
        "model": file_sha256(model),
        "library": load_model(model, library).library.content_hash,
        **asdict(options),
    }
    make = partial(_locate, model=model, library=library, options=options)
    return batch.run(_tasks(sources, batch), make, lambda one: how | one.made_of(), workers=workers)


def _locate(
    source: Input, path: Path, *, model: Path, library: Path | None, options: OutputOptions
) -> dict[str, Any]:
    found = predictions.locate(load_model(model, library), source.source, path, options=options)
    return _shown(found, path)


def reconstructions_in(folder: Path) -> Batch:
    """Reconstructions of measured files."""
    return Batch(folder, "reconstructions", {**APPEARANCE, **_ERRORS}, "CIEDE2000", has_balls=True)


def reconstruct_all(
    sources: Sequence[Input], library: Path, batch: Batch, *, without: Sequence[str] = (), numbers: int | None = None,
    options: OutputOptions, workers: Executor | None = None,
) -> list[Outcome[Input]]:  # fmt: skip
    """Reconstruct measured files from a library; see `reconstruction.reconstruct`."""
    how = {
        "library": Library(library).content_hash,
        "without": sorted(without),
        "numbers": numbers,
        **asdict(options),
    }
    make = partial(_reconstruct, library=library, without=tuple(without), numbers=numbers, options=options)
    return batch.run(_tasks(sources, batch), make, lambda one: how | one.made_of(), workers=workers)


def _reconstruct(
    source: Input,
    path: Path,
    *,
    library: Path,
    without: tuple[str, ...],
    numbers: int | None,
    options: OutputOptions,
) -> dict[str, Any]:
    made = predictions.reconstruct(
        library, source.source, path, without=without, numbers=numbers, options=options
    )
    return _shown(made, path)


def _shown(made: Reconstruction, path: Path) -> dict[str, Any]:
    return made.to_json() | ({} if made.refusal is not None else appearance(path))


def conversions_in(folder: Path) -> Batch:
    """Converted files."""
    columns: dict[str, Callable[[dict[str, Any]], Any]] = {
        "from": lambda content: content["source"],
        "bands": lambda content: content["bands"],
        **APPEARANCE,
        "cube root": lambda content: content["errors"]["cube_root"],
        "linear": lambda content: content["errors"]["linear"],
    }
    return Batch(folder, "conversions", columns, "cube root", has_balls=True)


def convert_all(
    sources: Sequence[Input], to: str, batch: Batch, *, correction: Path | None = None, options: Options,
    workers: Executor | None = None,
) -> list[Outcome[Input]]:  # fmt: skip
    """Convert files, or every sample of those with several, into one of `TARGETS`; see `conversion.convert`."""
    if to not in TARGETS:
        raise UsageError(f"no format '{to}', expected one of {', '.join(TARGETS)}")
    how = {"to": to, **options._asdict()}
    if correction is not None:
        how["correction"] = file_sha256(correction)
    suffix = next(iter(TARGETS[to].suffixes), f".{to}.txt")
    make = partial(_convert, to=to, correction=correction, options=options)
    todo = _tasks(sources, batch, suffix)
    return batch.run(todo, make, lambda one: how | one.made_of(), workers=workers)


def _convert(
    source: Input, path: Path, *, to: str, correction: Path | None, options: Options
) -> dict[str, Any]:
    with conversion.conversion_input([source.source]) as given:
        made = conversion.convert(
            given, path, to=to, sample=source.sample, correction=correction, options=options
        )
    brdf = open_source([path]).interpolated
    return made.to_json() | ({} if isinstance(brdf, UsageError) else appearance(path, brdf))


def renders_in(folder: Path) -> Batch:
    """Pictures of balls."""
    columns = {"material": lambda content: content["route"], "light": lambda content: content["illuminant"]}
    return Batch(folder, "renders", columns, has_balls=True)


def render_all(
    sources: Sequence[Input], settings: RenderSettings, batch: Batch, *, workers: Executor | None = None,
    ) -> list[Outcome[Input]]:  # fmt: skip
    """Render the balls of materials; see `renders.render`."""
    how = renders.settings_key(settings)
    make = partial(_render, settings=settings)
    todo = _tasks(sources, batch, ".png")
    return batch.run(todo, make, lambda one: how | one.made_of(), workers=workers)


def _render(source: Input, path: Path, *, settings: RenderSettings) -> dict[str, Any]:
    return renders.render(source.source, path, settings).to_json()


def _tasks(sources: Sequence[Input], batch: Batch, suffix: str = ".bsdf") -> list[Task[Input]]:
    return [Task(one.name, batch.folder / f"{one.name}{suffix}", one) for one in sources]
