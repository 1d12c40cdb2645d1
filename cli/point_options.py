"""Shared by `predict --from` and `render --from`: the option, and the report on the rows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold.errors import FileFormatError, UsageError

from . import terminal

if TYPE_CHECKING:
    from manifold.workflows.many_points import PointOutcome

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
    return output or Path(default)


def show_points(
    results: terminal.Results,
    what: str,
    folder: Path,
    outcomes: list[PointOutcome],
    failures: tuple[tuple[int, str], ...],
) -> None:
    """Print a line per row that is there, and raise FileFormatError where rows failed."""
    made = [outcome for outcome in outcomes if outcome.result is not None]
    results.table(
        ["file", "latent", ""],
        [(o.path.name, _place(o), "kept" * o.was_there) for o in made],
    )
    results.text(count_words(len(made), what, folder, sum(o.was_there for o in made)) + "\n")
    warned = [(o.path.name, found) for o in made if (found := (o.result or {}).get("diagnostics"))]
    for name, found in warned[:_MOST_WARNED]:
        results.sentence(f"{name}: {'; '.join(found)}")
    if warned[_MOST_WARNED:]:
        results.text(f"and diagnostics of {len(warned) - _MOST_WARNED} more (--json lists them)\n")
    bad = [*failures, *((o.point.line, o.failure) for o in outcomes if o.failure is not None)]
    failed = [f"line {line}: {words}" for line, words in sorted(bad)]
    rows = [
        {"line": o.point.line, "name": o.point.name, "kept": o.was_there} | (o.result or {}) for o in made
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


def _place(outcome: PointOutcome) -> str:
    place = outcome.point.place
    words = [place if isinstance(place, str) else ",".join(f"{v:.4g}" for v in place)]
    words += [f"{key} {value}" for key, value in vars(outcome.point.colour).items() if value is not None]
    return " ".join(words)
