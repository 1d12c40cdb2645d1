"""Predictions and renders at many latents of one map: materials are read once, finished files are kept."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from manifold.batch import Batch, Outcome, Task
from manifold.estimate import predictions
from manifold.estimate.sources import PlaceSource
from manifold.library.identity import file_sha256
from manifold.many.point_table import Point, PointTable
from manifold.model.manifold import Manifold, load_model
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions
from manifold.pictures import renders
from manifold.render import images
from manifold.render.render import RenderSettings, require_d65


def predict_all(
    model: Path, table: PointTable, folder: Path, *, library: Path | None = None,
    options: OutputOptions = DEFAULT_OPTIONS, workers: Executor | None = None,
) -> list[Outcome[Point]]:  # fmt: skip
    """Write the `.bsdf` of every row into a folder; what an earlier run made of the same row is kept.

    Args:
        model, library, options: as of `estimate.predict`.
        table: the rows.
        folder: where to; made if missing. Its `predictions.jsonl` says what each file was made of.
        workers: see `work.run`.
    Returns:
        One outcome per row; one that fails does not stop the others.
    Raises:
        UsageError, ModelError, LibraryError: the model or the folder cannot be used.
    """
    loaded = load_model(model, library)
    how = asdict(options)
    ending = "_rgb.bsdf" if loaded.bands.is_rgb else "_spec.bsdf"
    todo = [Task(p.name, _path(folder, p, ending), p) for p in table.points]
    make = partial(_predict, model=model, library=library, options=options)
    made_of = _made_of(model, loaded, how)
    return Batch(folder, "predictions").run(todo, make, made_of, workers=workers, prepare=loaded.prepare)


def _predict(
    point: Point, path: Path, *, model: Path, library: Path | None, options: OutputOptions
) -> dict[str, Any]:
    loaded = load_model(model, library)
    return predictions.predict(loaded, point.place, path, colour=point.colour, options=options).to_json()


def render_all(
    model: Path, table: PointTable, folder: Path, settings: RenderSettings, *, library: Path | None = None,
    direct: bool = False, workers: Executor | None = None,
) -> list[Outcome[Point]]:  # fmt: skip
    """Render the ball of every row into a folder; what an earlier run made of the same row is kept.

    Args:
        model, table, library, workers: as of `predict_all`.
        folder: where to; made if missing. Its `renders.jsonl` says what each picture was made of.
        settings: of all pictures.
        direct: evaluate the measured materials while rendering.
    Returns, raises: as `predict_all`.
    """
    loaded = load_model(model, library)  # which every render finds again
    if loaded.bands.is_rgb:
        require_d65(settings.illuminant)
    how = renders.settings_key(settings) | {"direct": direct}
    todo = [Task(p.name, _path(folder, p, ".png", images.SUFFIXES), p) for p in table.points]
    make = partial(_render, model=model, library=library, settings=settings, direct=direct)
    made_of = _made_of(model, loaded, how)
    return Batch(folder, "renders").run(todo, make, made_of, workers=workers, prepare=loaded.prepare)


def _render(
    point: Point, path: Path, *, model: Path, library: Path | None, settings: RenderSettings, direct: bool
) -> dict[str, Any]:
    source = PlaceSource(model, point.place, library, point.colour)
    return renders.render(source, path, settings, direct=direct).to_json()


def _made_of(model: Path, loaded: Manifold, how: dict[str, Any]) -> Callable[[Point], dict[str, Any]]:
    """A key of everything that a row's file depends on."""
    hashes = {"model_sha256": file_sha256(model), "library_hash": loaded.library.content_hash}

    def made_of(point: Point) -> dict[str, Any]:
        place = loaded.place(point.place)
        return (
            hashes
            | how
            | {"latent": place.latent.tolist(), "path": place.path, "colour": point.colour.made_of()}
        )

    return made_of


def _path(folder: Path, point: Point, ending: str, endings: tuple[str, ...] = (".bsdf",)) -> Path:
    """Of a row's file: the ending is added where its name has none of those."""
    has_one = point.name.lower().endswith(endings)
    return folder / (point.name if has_one else f"{point.name}{ending}")
