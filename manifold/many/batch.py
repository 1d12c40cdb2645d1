"""Makes many outputs of one command in several processes, then a table and a contact sheet of rendered balls.

An index in the folder records the inputs of every file, so that a later run only makes files that are missing or
whose inputs have changed. A file enters the index as soon as it is complete. One run at a time writes to a folder
(`.manifold.lock`).
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast

from filelock import FileLock, Timeout

from manifold import __version__
from manifold.brdf.interface import BRDF, EvaluableBRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core import disk, progress, work
from manifold.core.errors import FileAccessError, FileFormatError, ManifoldError, UsageError
from manifold.core.names import printable
from manifold.core.records import Array, BsdfFile
from manifold.estimate.attributes import lab_of
from manifold.estimate.gloss import gloss_units
from manifold.formats.readings import DAYLIGHT, GLOSS_ANGLES_DEG
from manifold.formats.recognition import is_rendered
from manifold.io_rgl import read_bsdf
from manifold.library.identity import alike, file_sha256, require_material_name
from manifold.render import backend, thumbnails

_MOST = 1 << 30  # bytes of an index: a row has about two thousand
_ENTRY = '{"file": '  # every line of an index begins so


class BatchSource(Protocol):
    """The input of one output; small enough to be sent to another process."""

    @property
    def name(self) -> str:
        """Return the name of the material and of its output."""

    def made_of(self) -> dict[str, Any]:
        """Return everything that the output depends on, as plain values."""


S = TypeVar("S", bound=BatchSource)
T = TypeVar("T")
Content = dict[str, Any]
"""The result of one output, as plain values."""
Beside = Callable[[Path, Content], Sequence[Path]]
"""A function that returns the other files that belong to an output, given its path and content."""


class SheetWarning(UserWarning):
    """Warns that a batch is complete, but that its contact sheet could not be drawn."""


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """The outcome of one output of a run: its file and result, or the reason of its failure.

    Attributes:
        path: path of the file, which exists unless its making failed.
        content: the result; None after a failure, unless only the writing of the file was refused.
        was_there: whether an earlier run made the file.
        failure: reason why there is no file; None if there is one.
        notes: notes for the user.
    """

    name: str
    path: Path
    source: T
    content: Content | None = None
    was_there: bool = False
    failure: str | None = None
    notes: tuple[str, ...] = ()

    def to_json(self) -> Content:
        """Return the content of the result and its path."""
        return {**(self.content or {}), "path": str(self.path)}


@dataclass(frozen=True)
class BatchCommand(Generic[S]):
    """The definition of a command for many sources: how an output is made, and how results are shown.

    Attributes:
        what: plural noun for the outputs, which names index, table, sheet and default folder.
        make: function that writes the file of a source and returns the result; it must be picklable for workers.
        how: plain values of all settings on which outputs depend.
        suffix: suffix of the output files; with a slash, each is a file in a folder of its own.
        endings: suffixes by which names of sources are recognised as files.
        columns: functions from a result to the cells of the table, by title.
        under: title of the column that is printed below the balls of the sheet.
        has_balls: whether a sheet is drawn, with the balls of `appearance`, or the files themselves if they are
            pictures.
        is_of_measured: whether the sheet also has the measured balls of `measured_appearance`.
        beside: function that names the other files of an output, except its balls; it must be picklable.
        prepare: called once in this process before it makes an output.
        conclude: called at the end with the outputs that were made.
        is_shared: whether the folder is meant for other people, so that index and lock are removed when it is
            complete.
    """

    what: str
    make: Callable[[S, Path], Content]
    how: Content
    suffix: str = ".bsdf"
    endings: tuple[str, ...] = ()
    columns: dict[str, Callable[[Content], Any]] = field(default_factory=dict)
    under: str | None = None
    has_balls: bool = False
    is_of_measured: bool = False
    beside: Beside | None = None
    prepare: Callable[[], None] | None = None
    conclude: Callable[[Batch[S]], None] | None = None
    is_shared: bool = False


def batch(
    command: BatchCommand[S], sources: Sequence[S], folder: Path, workers: Executor | None = None
) -> Batch[S]:
    """Make the outputs of all sources that no earlier run has made from the same inputs.

    If one output fails, the others are still made. Returns one outcome per source, in order. The folder is created if
    missing; for `workers` see `work.run`.
    """
    made = Batch(command, folder, [])
    with ExitStack() as at_end:
        at_end.enter_context(only_run_in(folder, command.what))
        index = OutputIndex(folder, command.what)
        outcomes, keys = _known(command, sources, folder, index)
        at_end.callback(made.write)  # also when it is interrupted
        at_end.callback(lambda: made.outcomes.extend(outcomes[k] for k in sorted(outcomes)))
        if keys and command.prepare is not None and workers is None:
            with progress.shown("Reading materials"):
                command.prepare()
        at_end.enter_context(progress.shown("Writing files"))
        missing = list(keys)
        todo = [(sources[k], made.path(sources[k])) for k in missing]
        is_shared = command.has_balls and workers is not None
        make = partial(_make, command.make, command.beside, is_shared)
        for done, (i, output, failure) in enumerate(work.run(make, todo, workers), start=1):
            k, (source, path) = missing[i], todo[i]
            if output is None:
                outcomes[k] = Outcome(printable(source.name), path, source, failure=failure)
            elif not output.files:
                refusal = output.content["refusal"]
                outcomes[k] = Outcome(source.name, path, source, output.content, failure=refusal)
            elif not _is_there(path):
                unseen = (
                    f"{path}: a worker wrote this file, but it is not visible here; use a folder that all machines "
                    "share"
                )
                outcomes[k] = Outcome(source.name, path, source, failure=unseen)
            else:
                index.add(path, keys[k], output.content, output.files)
                outcomes[k] = Outcome(source.name, path, source, output.content)
            progress.report(done, len(todo), source.name)
    if command.conclude is not None:
        command.conclude(made)
    if command.is_shared and not any(outcome.failure for outcome in made.outcomes):
        for left in (lock_of(folder), index_of(folder, command.what)):
            left.unlink(missing_ok=True)
    return made


def _known(
    command: BatchCommand[S], sources: Sequence[S], folder: Path, index: OutputIndex
) -> tuple[dict[int, Outcome[S]], dict[int, Content]]:
    """Return outcomes of the sources whose outputs exist, and keys of the others, by index."""
    outcomes: dict[int, Outcome[S]] = {}
    keys: dict[int, Content] = {}
    taken: dict[str, S] = {}
    for k, source in enumerate(sources):
        path = Batch(command, folder, []).path(source)
        try:
            require_material_name(source.name)
            if command.what in (alike(source.name), alike(path.stem)):
                raise UsageError("has the name of the table of results; rename it")
            first = taken.setdefault(alike(_within(folder, path)), source)
            if first is not source:
                raise UsageError(
                    f"{source} and {first} have the same name, {_within(folder, path)}; use two folders"
                )
            key = command.how | source.made_of()
            content = index.result(path, key, command.beside)
            if content is not None:
                outcomes[k] = Outcome(source.name, path, source, content, was_there=True)
            else:
                keys[k] = key
        except (ManifoldError, OSError) as error:
            outcomes[k] = Outcome(printable(source.name), path, source, failure=str(error))
    return outcomes, keys


@dataclass(frozen=True)
class Batch(Generic[S]):
    """The outputs of a command in a folder, for all sources."""

    command: BatchCommand[S]
    folder: Path
    outcomes: list[Outcome[S]]

    @property
    def sheet(self) -> Path:
        """Path of the contact sheet of rendered balls."""
        return self.folder / f"{self.command.what}.png"

    @property
    def tables(self) -> tuple[Path, Path]:
        """Paths of the table as CSV, and of all results as JSON."""
        return self.folder / f"{self.command.what}.csv", self.folder / f"{self.command.what}.json"

    def path(self, source: S) -> Path:
        """Return the path of a source's output."""
        is_file = bool(self.command.endings) and source.name.lower().endswith(self.command.endings)
        return self.folder / (source.name if is_file else f"{source.name}{self.command.suffix}")

    def row(self, outcome: Outcome[S]) -> dict[str, Any]:
        """Return the cells of an outcome in the table, by title."""
        content = outcome.content
        cells = {} if content is None else {title: of(content) for title, of in self.command.columns.items()}
        return {"name": outcome.name, "file": _within(self.folder, outcome.path), **cells}

    def to_json(self) -> dict[str, Any]:
        """Return the results of all files as plain values."""
        return {
            self.command.what: [
                {"name": o.name, "file": _within(self.folder, o.path), "kept": o.was_there} | o.content
                for o in self.outcomes
                if o.content is not None
            ],
            "failed": [f"{o.name}: {o.failure}" for o in self.outcomes if o.failure is not None],
        }

    def write(self) -> None:
        """Write the table, and draw the sheet."""
        text = json.dumps({"program": f"manifold {__version__}", **self.to_json()}, indent=1)
        of_rows, of_all = self.tables
        disk.write_text(of_all, text + "\n")
        titles = ["name", "file", *self.command.columns, "notes", "failed"]
        table = io.StringIO()
        writer = csv.DictWriter(table, titles)
        writer.writeheader()
        for o in self.outcomes:
            writer.writerow(self.row(o) | {"notes": "; ".join(notes_of(o)), "failed": o.failure})
        disk.write_text(of_rows, table.getvalue())
        if self.command.has_balls and any(ball_path(o.path).is_file() for o in self.outcomes):
            from manifold.pictures import figures

            cells = [(o.name, self._under(o), self._balls(o.path)) for o in self.outcomes]
            try:
                figures.save(figures.contact_sheet(cells, self.command.under), self.sheet)
            except Exception as error:  # those of Pillow and Matplotlib are of many kinds
                warnings.warn(
                    f"{self.sheet.name}: the sheet of balls could not be drawn ({error}); everything else is written",
                    SheetWarning,
                    stacklevel=2,
                )

    def _balls(self, path: Path) -> tuple[Path, ...]:
        """Return the balls of a cell of the sheet: measured beside predicted where there are both."""
        both = (measured_ball_path(path), ball_path(path))
        return both if self.command.is_of_measured else both[1:]

    def _under(self, outcome: Outcome[S]) -> str:
        if outcome.failure is not None:
            return "failed"
        value = None if self.command.under is None else self.row(outcome)[self.command.under]
        return "" if value is None else cell(value)


def _within(folder: Path, path: Path) -> str:
    """Return the path of an output within its folder."""
    return path.relative_to(folder).as_posix()


def cell(value: Any) -> str:
    """Return a value as a cell of a table, to three digits; numbers below 0.001 to three decimal places."""
    if isinstance(value, float):
        return f"{value:z.3f}" if 0.0 < abs(value) < 1e-3 else f"{value:.3g}"
    return "" if value is None else str(value)


def notes_of(outcome: Outcome[Any]) -> list[str]:
    """Return sentences with the notes on a file, and on the prediction that it shows."""
    content = outcome.content or {}
    parts = (content, content.get("prediction") or {})
    return [
        *outcome.notes,
        *(note for part in parts for kind in ("diagnostics", "notes") for note in part.get(kind, ())),
    ]


def ball_path(path: Path) -> Path:
    """Return the path of the picture of a file's ball; for a picture, the path itself."""
    return path if path.suffix.lower() == ".png" else path.parent / "balls" / f"{path.stem}.png"


def _is_there(path: Path) -> bool:
    """Return whether a file exists, including one that another machine has just written."""
    if not path.is_file():
        os.scandir(path.parent).close()  # a network file system then forgets that there was none
    return path.is_file()


def measured_ball_path(path: Path) -> Path:
    """Return the path for a picture of the measured material that a file describes."""
    return path.parent / "balls" / "measured" / f"{path.stem}.png"


def appearance(path: Path, brdf: EvaluableBRDF | None = None) -> dict[str, Any]:
    """Return the colour and gloss of a BRDF, by default of the RGL file at the path, and draw its ball."""
    brdf = MeasuredBRDF(read_bsdf(path)) if brdf is None else brdf
    if backend.is_available():
        is_file = is_rendered(path)
        image = thumbnails.of_file(path) if is_file else thumbnails.of_material(cast(BRDF, brdf))
        _write_ball(ball_path(path), image)
    return {"appearance": _look(brdf)}


def measured_appearance(path: Path, measured: BsdfFile) -> dict[str, Any]:
    """Return the colour and gloss of the measured material that a file describes, and draw its ball."""
    if backend.is_available():
        _write_ball(measured_ball_path(path), thumbnails.of_material(measured))
    return {"measured": _look(MeasuredBRDF(fill_unmeasured(measured)))}


def _write_ball(path: Path, image: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    thumbnails.write(path, image)


def _look(brdf: EvaluableBRDF) -> dict[str, Any]:
    units = {f"{angle:g}": value for angle, value in gloss_units(brdf, GLOSS_ANGLES_DEG).items()}
    return {"lab": lab_of(brdf).tolist(), "viewing": f"{DAYLIGHT}, 45/0", "gloss": units}


def appearance_columns(word: str, key: str = "appearance") -> dict[str, Callable[[Content], Any]]:
    """Return columns of a table whose titles end in a word: CIELAB, and gloss units at 60 degrees.

    They show the results of `appearance` or, with the key `measured`, of `measured_appearance`.
    """

    def column(value: Callable[[dict[str, Any]], Any]) -> Callable[[Content], Any]:
        return lambda content: value(content[key]) if key in content else None

    def lab(k: int) -> Callable[[Content], Any]:
        return column(lambda look: look["lab"][k])

    columns = {"L": lab(0), "a": lab(1), "b": lab(2), "gloss 60": column(lambda look: look["gloss"]["60"])}
    return {f"{title} {word}": value for title, value in columns.items()}


def _viewing(content: Content) -> Any:
    return content["appearance"].get("viewing") if "appearance" in content else None


LAB_UNDER: dict[str, Callable[[Content], Any]] = {"Lab under": _viewing}
"""The column that says which light, observer and geometry the colours of `appearance_columns` have."""
PREDICTED = appearance_columns("predicted") | LAB_UNDER
MEASURED = appearance_columns("measured", "measured")


class _Made(NamedTuple):
    """The result of an output, and the hashes of its files by relative path; none if it was refused."""

    content: Content
    files: dict[str, str]


def _make(
    make: Callable[[S, Path], Content], beside: Beside | None, is_shared: bool, task: tuple[S, Path]
) -> _Made:
    if is_shared:
        _keep_to_one_thread()
    content = make(*task)
    return _Made(content, {} if content.get("refusal") is not None else _hashes(task[1], content, beside))


def _hashes(path: Path, content: Content, beside: Beside | None) -> dict[str, str]:
    """Return the hashes of the files that belong to an output, by their paths relative to its folder."""
    files = [path, *(() if beside is None else beside(path, content))]
    if backend.is_available():
        balls = {"appearance": ball_path, "measured": measured_ball_path}
        files += [ball(path) for key, ball in balls.items() if key in content]
    return {os.path.relpath(file, path.parent): file_sha256(file) for file in files}


@lru_cache
def _keep_to_one_thread() -> None:
    """Keep Dr.Jit to one thread, in a process beside others."""
    if backend.is_available():
        backend.drjit().set_thread_count(0)


def make_folder(folder: Path, what: str) -> None:
    """Create the folder for many outputs; `what` names the outputs in messages."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "is a file" if folder.is_file() else f"cannot be made ({error.strerror})"
        raise UsageError(f"{folder}: {reason}, expected a folder for {what}; name another") from error


def lock_of(folder: Path) -> Path:
    """Return the path of the lock of a folder to which a run writes."""
    return folder / ".manifold.lock"


def index_of(folder: Path, what: str) -> Path:
    """Return the path of the index of a folder's outputs."""
    return folder / f"{what}.jsonl"


@contextmanager
def only_run_in(folder: Path, what: str) -> Iterator[None]:
    """Create a folder and hold its lock during the block, so that two runs do not mix their results."""
    make_folder(folder, what)
    lock = FileLock(lock_of(folder))
    disk.require_lockable(Path(lock.lock_file))
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise UsageError(
            f"{folder}: another run writes to this folder; wait until it is done, or name another folder"
        ) from None
    except OSError as error:
        raise FileAccessError(
            f"{folder}: cannot be written ({error.strerror}); name another folder"
        ) from error
    try:
        yield
    finally:
        lock.release()


class OutputIndex:
    """An index of a folder's files and their inputs: one line of JSON per file, appended when the file is complete.

    If a file has several lines, the last one counts. The index of `exports` is the file `exports.jsonl`.
    """

    def __init__(self, folder: Path, what: str) -> None:
        self._path = index_of(folder, what)
        self._entries: dict[str, Any] = {}
        if not self._path.is_file():
            return
        content = disk.read_bytes(self._path, advice="name another folder", most=_MOST).decode(
            errors="replace"
        )
        *lines, torn = content.split("\n")
        try:
            if not all(line.startswith(_ENTRY[: len(line)]) for line in (*lines, torn)):
                raise ValueError
            for entry in map(json.loads, lines):
                if not isinstance(entry["file"], str):
                    raise ValueError
                if entry.pop("digest", None) == _digest(entry):  # others may have changed the line
                    self._entries[entry["file"]] = entry
        except (ValueError, KeyError, RecursionError):
            raise FileFormatError(
                f"{self._path}: not an index of {what}; name another folder, or remove it"
            ) from None
        if torn:  # by a killed run
            disk.write_text(self._path, content.removesuffix(torn))

    def result(self, path: Path, made_of: dict[str, Any], beside: Beside | None = None) -> Content | None:
        """Return the result of an output that this version made from the same inputs; None if a file changed."""
        entry = self._entries.get(_within(self._path.parent, path))
        if entry is None or entry.get("made_of") != _stamped(made_of):
            return None
        result: Content = entry["result"]
        try:
            is_whole = _hashes(path, result, beside).items() <= entry.get("files", {}).items()
        except OSError:  # one is missing
            return None
        return result if is_whole else None

    def add(self, path: Path, made_of: dict[str, Any], result: Content, files: dict[str, str]) -> None:
        """Record an output that was written, its result and the hashes of its files, as plain values of JSON."""
        name = _within(self._path.parent, path)
        entry = {
            "file": name,
            "made_of": _stamped(made_of),
            "files": files,
            "result": result,
        }
        self._entries[name] = entry
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry | {"digest": _digest(entry)}, allow_nan=False) + "\n")
        except OSError as error:
            raise FileAccessError(
                f"{self._path}: cannot be written ({error.strerror}); check the folder"
            ) from error


def _digest(entry: dict[str, Any]) -> str:
    """Return a hash of an entry of an index, of plain values."""
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()


def _stamped(made_of: dict[str, Any]) -> dict[str, Any]:
    return dict(json.loads(json.dumps(made_of | {"program": f"manifold {__version__}"})))
