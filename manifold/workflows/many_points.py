"""Predictions and renders at many latents of one map: materials are read once, finished files are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold.errors import ManifoldError, UsageError
from manifold.library.identity import file_sha256, hash_arrays
from manifold.model import predicted_file
from manifold.model.manifold import Manifold
from manifold.rendering import backend, images
from manifold.rendering.render import RenderSettings, require_d65
from manifold.system.stages import Progress, Stage, no_stage, with_progress
from manifold.workflows import renders
from manifold.workflows.output_index import OutputIndex
from manifold.workflows.point_table import Point, PointTable

Check = Callable[[Path], object]
"""Raises UsageError for a file that is not to be replaced."""


@dataclass(frozen=True)
class PointOutcome:
    """The result of one row.

    Attributes:
        point: the row.
        path: of the file.
        result: what is known of it, plain values; None where it failed.
        was_there: whether an earlier run had made it.
        failure: why there is none, else None.
    """

    point: Point
    path: Path
    result: dict[str, Any] | None
    was_there: bool = False
    failure: str | None = None


def predict_all(
    model: Path, table: PointTable, folder: Path, *, library: Path | None = None, physical: bool = False,
    force: bool = False, resolution: int = 32, n_theta_i: int = 8, check: Check | None = None,
    stage: Stage = no_stage,
) -> list[PointOutcome]:  # fmt: skip
    """Write the `.bsdf` of every row into a folder; what an earlier run made of the same row is kept.

    Args:
        model, library, physical, force, resolution, n_theta_i: as of `predicted_file.predict`.
        table: the rows.
        folder: where to; made if missing. Its `predictions.json` says what each file was made of.
        check: called before a file is replaced.
        stage: opens the progress of a part of the work.
    Returns:
        One outcome per row; one that fails does not stop the others.
    Raises:
        UsageError, ModelError, LibraryError: the model or the folder cannot be used.
    """
    loaded = Manifold.load(model, library)
    ending = "_rgb.bsdf" if loaded.bands.is_rgb else "_spec.bsdf"
    points = table.among(loaded.names).points
    paths = [_path(folder, point, ending, (".bsdf",)) for point in points]
    how = {"physical": physical, "resolution": resolution, "incidences": n_theta_i}

    def make(point: Point, path: Path) -> dict[str, Any]:
        return predicted_file.predict(
            loaded, point.place, path, colour=point.colour, physical=physical, force=force,
            resolution=resolution, n_theta_i=n_theta_i,
        ).to_json()  # fmt: skip

    made_of = _made_of(model, loaded, how)
    with OutputIndex(folder, "predictions") as index:
        return _make_missing(index, points, paths, made_of, make, loaded.prepare, check, stage)


def render_all(
    model: Path, table: PointTable, folder: Path, settings: RenderSettings, *, library: Path | None = None,
    direct: bool = False, check: Check | None = None, stage: Stage = no_stage,
) -> list[PointOutcome]:  # fmt: skip
    """Render the ball of every row into a folder; what an earlier run made of the same row is kept.

    Args:
        model, table, library, check, stage: as of `predict_all`.
        folder: where to; made if missing. Its `renders.json` says what each picture was made of.
        settings: of all pictures.
        direct: evaluate the measured materials while rendering.
    Returns, raises: as `predict_all`.
    """
    from manifold.rendering.plugin.bsdf import load_model

    loaded = load_model(model, library)  # which every render finds again
    if loaded.bands.is_rgb:
        require_d65(settings.illuminant)
    light = settings.illuminant
    arrays = {"wavelengths_nm": np.array(light.wavelengths_nm), "power": np.array(light.power)}
    if settings.environment is not None:
        arrays["environment"] = settings.environment
    how = {
        "size": settings.size, "samples": settings.samples, "seed": settings.seed, "direct": direct,
        "backend": backend.choose().kind, "light": hash_arrays(arrays),
    }  # fmt: skip

    def make(point: Point, path: Path) -> dict[str, Any]:
        with renders.latent_source(
            model, point.place, library=library, colour=point.colour, direct=direct
        ) as source:
            return renders.render(source, path, settings).to_json()

    made_of = _made_of(model, loaded, how)
    points = table.among(loaded.names).points
    paths = [_path(folder, point, ".png", images.SUFFIXES) for point in points]
    with OutputIndex(folder, "renders") as index:
        return _make_missing(index, points, paths, made_of, make, loaded.prepare, check, stage)


def _made_of(model: Path, loaded: Manifold, how: dict[str, Any]) -> Callable[[Point], dict[str, Any]]:
    """A key of everything that a row's file depends on."""
    hashes = {"model_sha256": file_sha256(model), "library_hash": loaded.library.content_hash}

    def made_of(point: Point) -> dict[str, Any]:
        x = loaded.require_latent(point.place)
        colour: dict[str, Any] = asdict(point.colour)
        file = point.colour.reflectance
        if isinstance(file, Path):
            if not file.is_file():
                raise UsageError(f"{file}: no such file, expected a reflectance")
            colour["reflectance"] = file_sha256(file)
        return hashes | how | {"latent": x.tolist(), "colour": colour}

    return made_of


def _path(folder: Path, point: Point, ending: str, endings: tuple[str, ...]) -> Path:
    """Of a row's file: the ending is added where its name has none."""
    has_one = point.name.lower().endswith(endings)
    return folder / (point.name if has_one else f"{point.name}{ending}")


def _make_missing(
    index: OutputIndex, points: Sequence[Point], paths: Sequence[Path], made_of: Callable[[Point], dict[str, Any]],
    make: Callable[[Point, Path], dict[str, Any]], prepare: Callable[[Progress | None], None],
    check: Check | None, stage: Stage,
) -> list[PointOutcome]:  # fmt: skip
    """An outcome per row.

    Args:
        index: of the folder.
        points, paths: the rows and their files.
        made_of: all that a row's file depends on.
        make: writes a row's file and says what is known of it.
        prepare: called once, if anything is to be made.
        check: called before a file is replaced, if any.
        stage: opens the progress of a part of the work.
    """

    def kept(point: Point, path: Path) -> dict[str, Any] | None:
        return index.result(path, made_of(point))

    def made(point: Point, path: Path) -> dict[str, Any]:
        if check is not None:
            check(path)
        result = make(point, path)
        index.add(path, made_of(point), result)
        return result

    outcomes = [
        _attempt(kept, point, path, was_there=True) for point, path in zip(points, paths, strict=True)
    ]
    missing = [k for k, found in enumerate(outcomes) if found.result is None and found.failure is None]
    if missing:
        with stage("Reading materials") as step:
            prepare(step)
    with stage("Writing files") as step:
        for k in with_progress(missing, step, lambda k: points[k].name):
            outcomes[k] = _attempt(made, points[k], paths[k])
    return outcomes


def _attempt(
    ask: Callable[[Point, Path], dict[str, Any] | None], point: Point, path: Path, *, was_there: bool = False
) -> PointOutcome:
    try:
        return PointOutcome(point, path, ask(point, path), was_there)
    except ManifoldError as error:
        return PointOutcome(point, path, None, failure=str(error))
