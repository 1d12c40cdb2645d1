"""Shared by `predict --from` and `render --from`: the option, and the report on the rows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold.errors import FileFormatError, UsageError

from . import terminal
from .outputs import or_default

if TYPE_CHECKING:
    from manifold.workflows.output_index import Outcome
    from manifold.workflows.point_table import Point

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


def folder_or_default(output: Path | None, default: str) -> Path:
    """The folder that was named, or else a default.

    Raises:
        UsageError: it is named like a file.
    """
    if output is not None and output.suffix.lower() in _FILES and not output.is_dir():
        raise UsageError(f"{output}: named like a file, expected a folder for many files; name another")
    return or_default(output, default)


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
