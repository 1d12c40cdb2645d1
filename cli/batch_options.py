"""Shared by commands that make many files: options, and the report on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manifold.errors import FileFormatError, UsageError

from . import terminal
from .outputs import or_default

if TYPE_CHECKING:
    from manifold.batch import Batch, Outcome
    from manifold.estimate.inputs import Input
    from manifold.estimate.sources import MaterialSource
    from manifold.many.point_table import Point

_MOST_WARNED = 5
_FILES = (".bsdf", ".png", ".exr", ".csv", ".json")

PointsOption = Annotated[
    Path | None,
    typer.Option(
        "--from",
        help="Several latents: a CSV table with columns x,y,... or latent or material, and optionally name, like, "
        "srgb, reflectance. The output is a folder; files of an earlier run that match their rows are kept.",
        metavar="CSV",
    ),
]  # fmt: skip


def is_many(sources: Sequence[MaterialSource], output: Path | None) -> bool:
    """Whether sources are for a folder: several, a folder or a library, or where the output is a folder."""
    from manifold.estimate import inputs

    return inputs.is_many(sources) or (output is not None and output.is_dir())


def inputs_of(
    sources: Sequence[MaterialSource],
    output: Path | None,
    is_wanted: Callable[[Path], bool] | None = None,
    *,
    samples: bool = False,
) -> list[Input] | None:
    """The materials of several sources, of a folder, a library or a file of several samples; None for one.

    Args:
        sources: as they were given.
        output: likewise; a folder that is there is for several.
        is_wanted: which files of folders; RGL files if None.
        samples: whether a file of several samples is several materials.
    Raises:
        UsageError: a source is missing, or a folder is read and written.
    """
    from manifold.estimate import inputs
    from manifold.estimate.sources import FileSource

    many = is_many(sources, output)
    files = [source.path for source in sources if isinstance(source, FileSource)]
    if not many and not (samples and files and (output is None or not output.suffix)):
        return None
    found = inputs.find_inputs(sources, is_wanted or inputs.is_rgl, samples=samples)
    if not many and len(found) == 1:
        return None
    if output is not None:
        inputs.require_apart(files, output)
    return found


def folder_or_default(output: Path | None, default: str, outputs: str = "many files; name another") -> Path:
    """The folder that was named, or else a default.

    Raises:
        UsageError: it is named like a file.
    """
    if output is not None and output.suffix.lower() in _FILES and not output.is_dir():
        raise UsageError(f"{output}: named like a file, expected a folder for {outputs}")
    return or_default(output, default)


def show_batch(results: terminal.Results, batch: Batch, outcomes: Sequence[Outcome[Any]]) -> None:
    """Print a line per file, and raise FileFormatError where some failed."""
    from manifold.batch import cell, notes_of

    known = [outcome for outcome in outcomes if outcome.content is not None]
    rows = [
        batch.row(o) | {"notes": len(notes_of(o)) or "", "": "refused" if o.failure else "kept" * o.was_there}
        for o in known
    ]
    if rows:
        results.table([*rows[0]], [[cell(value) for value in row.values()] for row in rows])
    made = [outcome for outcome in known if outcome.failure is None]
    results.text(count_words(len(made), batch.what, batch.folder, sum(o.was_there for o in made)) + "\n")
    listed = [path.name for path in (batch.sheet, *batch.tables) if path.is_file()]
    results.text(f"there: {', '.join(listed)}\n")
    document = batch.document(outcomes)
    results.document(document)
    raise_failed(document["failed"])


def show_points(
    results: terminal.Results,
    what: str,
    folder: Path,
    outcomes: list[Outcome[Point]],
    failures: tuple[tuple[int, str], ...],
) -> None:
    """Print a line per row that is there, and raise FileFormatError where rows failed."""
    made = [outcome for outcome in outcomes if outcome.content is not None]
    results.table(
        ["file", "latent", ""],
        [(o.path.name, _place(o.source), "kept" * o.was_there) for o in made],
    )
    results.text(count_words(len(made), what, folder, sum(o.was_there for o in made)) + "\n")
    warned = [(o.path.name, found) for o in made if (found := (o.content or {}).get("diagnostics"))]
    for name, found in warned[:_MOST_WARNED]:
        results.sentence(f"{name}: {'; '.join(found)}")
    if warned[_MOST_WARNED:]:
        results.text(f"and diagnostics of {len(warned) - _MOST_WARNED} more (--json lists them)\n")
    bad = [*failures, *((o.source.line, o.failure) for o in outcomes if o.failure is not None)]
    failed = [f"line {line}: {words}" for line, words in sorted(bad)]
    rows = [
        {"line": o.source.line, "name": o.source.name, "kept": o.was_there} | (o.content or {}) for o in made
    ]
    results.document({what: rows, "failed": failed})
    raise_failed(failed)


def count_words(count: int, what: str, folder: Path, kept: int) -> str:
    """How many files are in a folder, and how many of them an earlier run had made."""
    return f"{count} {what} in {folder}" + (f", {kept} of them kept" if kept else "")


def raise_failed(failed: list[str]) -> None:
    """Raise FileFormatError for the first few of what failed."""
    if failed:
        raise FileFormatError(terminal.first_three(failed))


def _place(point: Point) -> str:
    place = point.place
    words = [place if isinstance(place, str) else ",".join(f"{v:.4g}" for v in place)]
    words += [f"{key} {value}" for key, value in vars(point.colour).items() if value is not None]
    return " ".join(words)
