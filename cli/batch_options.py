"""Options of commands that write many files or use several processes, and the output of such commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import typer

from manifold.core.errors import FileFormatError, UsageError

from . import terminal
from .application import SHARED
from .outputs import checked, or_default

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from contextlib import AbstractContextManager

    from manifold.estimate.inputs import Input
    from manifold.estimate.sources import MaterialSource
    from manifold.many.batch import Batch, BatchCommand, BatchSource

    S = TypeVar("S", bound=BatchSource)


_MOST_WORKERS = 1024


def _workers_option(by_default: str) -> Any:
    """Return the option `--workers` for an annotation."""
    return typer.Option(
        "--workers",
        "-j",
        help=f"Local processes that share the work. [default: {by_default}]",
        metavar="N",
        min=1,
        max=_MOST_WORKERS,
        rich_help_panel=SHARED,
    )


SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        help="Share the work among the workers of this Dask scheduler, such as tcp://10.0.0.1:8786.",
        metavar="ADDRESS",
        rich_help_panel=SHARED,
    ),
]


@dataclass(frozen=True)
class WorkerOptions:
    """Options for the processes that share the work of a command: by default one per core."""

    workers: Annotated[int | None, _workers_option("one per core, for several materials")] = None
    scheduler: SchedulerOption = None
    default: ClassVar[int | None] = None

    def executor(self) -> AbstractContextManager[Executor | None]:
        """Return a context manager for the executor that `work.run` takes."""
        from manifold.core import work

        if self.scheduler is None:
            return work.processes(self.workers or self.default)
        if self.workers is not None:
            raise UsageError(
                f"found --workers {self.workers} and --scheduler {self.scheduler}, expected one of them"
            )
        from manifold.core import cluster

        return cluster.workers(self.scheduler)


@dataclass(frozen=True)
class OneWorkerOptions(WorkerOptions):
    """Worker options with the default of running in this process."""

    workers: Annotated[int | None, _workers_option("1")] = None
    default: ClassVar[int | None] = 1


@dataclass(frozen=True)
class ThreadOptions(OneWorkerOptions):
    """Worker options with the default of threads of this process."""

    workers: Annotated[int | None, _workers_option("one process with several threads")] = None


PER_CORE, ONE, THREADS = WorkerOptions(), OneWorkerOptions(), ThreadOptions()
"""The default of options that are not given."""


_MOST_NOTES = 20  # that are printed; the table has all
_MOST_NAMES = 3  # in front of a note
_FILES = (".bsdf", ".png", ".exr", ".csv", ".json")

PointsOption = Annotated[
    Path | None,
    typer.Option(
        "--from",
        help="Several points: a CSV table with columns x,y,... or latent or material, and optionally name, like, "
        "srgb, reflectance. The output is a folder; files of an earlier run that match their rows are kept.",
        metavar="CSV",
    ),
]  # fmt: skip


def is_many(sources: Sequence[MaterialSource], output: Path | None) -> bool:
    """Return whether the output must be a folder: for several sources, a folder or a library, or if it is one."""
    from manifold.estimate import inputs

    return inputs.is_many(sources) or (output is not None and output.is_dir())


def inputs_of(
    sources: Sequence[MaterialSource],
    output: Path | None,
    is_wanted: Callable[[Path], bool] | None = None,
    *,
    samples: bool = False,
) -> list[Input] | None:
    """Return the materials of several sources, a folder, a library or a file of several samples; None for one material.

    An existing output folder means several. By default only RGL files of folders are used; with `samples`, each
    sample of a file is a material.
    """
    from manifold.estimate import inputs
    from manifold.estimate.sources import FileSource
    from manifold.formats.recognition import is_rgl

    many = is_many(sources, output)
    files = [source.path for source in sources if isinstance(source, FileSource)]
    if not many and not (samples and files and (output is None or not output.suffix)):
        return None
    found = inputs.find_inputs(sources, is_wanted or is_rgl, samples=samples)
    if not many and len(found) == 1:
        return None
    if output is not None:
        inputs.require_apart(files, output)
    return found


def require_folder(output: Path | None, outputs: str, suffix: str = ".bsdf") -> None:
    """Raise UsageError if an output that must be a folder is named like a file, with this or any other suffix."""
    suffixes = (*_FILES, f".{suffix.rpartition('.')[2]}")
    if output is not None and output.suffix.lower() in suffixes and not output.is_dir():
        raise UsageError(f"{output}: named like a file, expected a folder for {outputs}")


def make_many(
    results: terminal.Results, command: BatchCommand[S], sources: Sequence[S], output: Path | None,
    workers: AbstractContextManager[Executor | None] | None = None, *, outputs: str = "many files; name another",
    failed: Sequence[str] = (), then: Callable[[Batch[S]], object] | None = None,
) -> None:  # fmt: skip
    """Make the outputs of a batch command in a folder, by default its usual folder, and print a line for each.

    `outputs` is the text of the error for an invalid folder, `failed` holds the errors of other sources, and `then`
    is called with the outcomes before they are printed. For `workers` see `WorkerOptions.executor`.
    """
    from manifold.estimate import inputs
    from manifold.many.batch import MEASURED, Batch, batch, cell, notes_of

    require_folder(output, outputs, command.suffix)
    folder = or_default(output, command.what)
    planned = Batch(command, folder, [])
    for path in (*planned.tables, planned.sheet):
        checked(path)
    inputs.require_apart([path for source in sources for path in inputs.files_of(source)], folder)
    with workers or nullcontext() as entered:
        made = batch(command, sources, folder, entered)
    if then is not None:
        then(made)
    known = [outcome for outcome in made.outcomes if outcome.content is not None]
    rows = [
        {title: value for title, value in made.row(o).items() if title not in MEASURED}  # which the file has
        | {"": "refused" if o.failure else "kept" * o.was_there}
        for o in known
    ]
    if rows:
        results.table([*rows[0]], [[cell(value) for value in row.values()] for row in rows])
    notes = _grouped({o.name: notes_of(o) for o in known})
    for note in notes[:_MOST_NOTES]:
        results.sentence(note)
    if len(notes) > _MOST_NOTES:
        results.text(f"and {len(notes) - _MOST_NOTES} more notes in {made.tables[0].name}\n")
    done = [outcome for outcome in known if outcome.failure is None]
    kept = sum(o.was_there for o in done)
    results.text(
        f"{len(done)} {command.what} in {folder}" + (f", {kept} of them kept" if kept else "") + "\n"
    )
    listed = [path.name for path in (made.sheet, *made.tables) if path.is_file()]
    results.text(f"with {', '.join(listed)}\n")
    document = made.to_json()
    document["failed"] = [*failed, *document["failed"]]
    results.document(document)
    if document["failed"]:
        raise FileFormatError(terminal.first_three(document["failed"]))


def _grouped(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Return each note once, behind the names of the materials that have it."""
    names: dict[str, list[str]] = {}
    for name, own in notes.items():
        for note in dict.fromkeys(own):
            names.setdefault(note, []).append(name)
    return [f"{_named(having, len(notes))}: {note}" for note, having in names.items()]


def _named(names: Sequence[str], count: int) -> str:
    """Return some names of `count`; of more than three, their number."""
    if len(names) <= _MOST_NAMES:
        return ", ".join(names)
    return f"all {count}" if len(names) == count else f"{len(names)} of {count}"
