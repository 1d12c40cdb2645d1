"""Many outputs of one run; the index of their folder says what each was made from, and later runs make the rest."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from manifold import __version__
from manifold.errors import FileFormatError, ManifoldError, UsageError
from manifold.library.identity import file_sha256
from manifold.system import atomic, reading
from manifold.system.names import printable
from manifold.system.stages import Progress, Stage, no_stage, with_progress

_MOST = 1 << 30  # bytes of an index: a row has about two thousand
_SAVED_EVERY_S = 5.0  # of many files; what a killed run has not saved is made again

S = TypeVar("S")


@dataclass(frozen=True)
class Outcome(Generic[S]):
    """One of the outputs of a run.

    Attributes:
        name: of the material.
        path: of the file, which is there where nothing failed.
        source: what it is made of.
        content: what is known of it, plain values; None where it failed.
        was_there: whether an earlier run had made it.
        failure: why there is none, else None.
        notes: what a user should know of it.
    """

    name: str
    path: Path
    source: S
    content: dict[str, Any] | None = None
    was_there: bool = False
    failure: str | None = None
    notes: tuple[str, ...] = ()


def make_folder(folder: Path, what: str) -> None:
    """Make the folder of many outputs, `what` in words.

    Raises:
        UsageError: it is a file, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "is a file" if folder.is_file() else f"cannot be made ({error.strerror})"
        raise UsageError(f"{folder}: {reason}, expected a folder for {what}; name another") from error


class OutputIndex:
    """The JSON file beside the outputs of a run of many, as a context: it is complete when the block ends.

    Args:
        folder: of the outputs; made if missing.
        what: they are, in the plural; `exports` makes `exports.json`.
    Raises:
        UsageError: the folder cannot be made, or is a file.
        FileFormatError: there is another file of the index's name.
    """

    def __init__(self, folder: Path, what: str) -> None:
        make_folder(folder, what)
        self._path, self._what, self._format = folder / f"{what}.json", what, f"manifold {what}"
        self._entries: dict[str, Any] = {}
        self._is_changed, self._saved_s = False, time.monotonic()
        if self._path.is_file():
            content = reading.read_json(self._path, f"the index of a folder of {what}", _MOST)
            known = content.get(what) if isinstance(content, dict) else None
            if not isinstance(known, dict) or content.get("format") != self._format:
                raise FileFormatError(
                    f"{self._path}: not an index of {what}; name another folder, or remove it"
                )
            self._entries = known

    def __enter__(self) -> OutputIndex:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._is_changed:
            self._save()

    def result(self, path: Path, made_of: dict[str, Any]) -> dict[str, Any] | None:
        """The entry of an existing, unchanged file that this version made from the same inputs, else None."""
        entry = self._entries.get(path.name)
        if not isinstance(entry, dict) or entry.get("made_of") != self._stamped(made_of):
            return None
        if not path.is_file() or entry.get("file_sha256") != file_sha256(path):
            return None
        result = entry.get("result")
        return result if isinstance(result, dict) else None

    def add(self, path: Path, made_of: dict[str, Any], result: dict[str, Any]) -> None:
        """Note a file that was written, and what is known of it: all plain values of JSON.

        Raises:
            UsageError: the index cannot be written.
        """
        made_of = self._stamped(made_of)
        self._entries[path.name] = {"made_of": made_of, "file_sha256": file_sha256(path), "result": result}
        self._is_changed = True
        if time.monotonic() - self._saved_s > _SAVED_EVERY_S:
            self._save()

    def _save(self) -> None:
        content = {"format": self._format, "program": f"manifold {__version__}", self._what: self._entries}
        atomic.write_text(self._path, json.dumps(content, indent=1, allow_nan=False) + "\n")
        self._is_changed, self._saved_s = False, time.monotonic()

    def _stamped(self, made_of: dict[str, Any]) -> dict[str, Any]:
        return dict(json.loads(json.dumps(made_of | {"program": f"manifold {__version__}"})))


def make_missing(
    index: OutputIndex,
    tasks: Sequence[tuple[str, Path, S]],
    made_of: Callable[[S], dict[str, Any]],
    make: Callable[[S, Path], dict[str, Any]],
    *,
    prepare: Callable[[Progress | None], None] | None = None,
    stage: Stage = no_stage,
) -> list[Outcome[S]]:
    """Make the files that an earlier run has not made of the same; one that fails does not stop the others.

    Args:
        index: of the folder.
        tasks: name, file and source of each.
        made_of: all that the file of a source depends on.
        make: writes the file of a source and says what is known of it.
        prepare: called once, if anything is to be made.
        stage: opens the progress of a part of the work.
    Returns:
        An outcome per task.
    """
    outcomes: list[Outcome[S]] = []
    missing: list[int] = []
    for k, (name, path, source) in enumerate(tasks):
        try:
            known = index.result(path, made_of(source))
            missing += [k] * (known is None)
            outcomes.append(Outcome(name, path, source, known, was_there=True))
        except ManifoldError as error:
            outcomes.append(Outcome(printable(name), path, source, failure=str(error)))
    if missing and prepare is not None:
        with stage("Reading materials") as step:
            prepare(step)
    with stage("Writing files") as step:
        for k in with_progress(missing, step, lambda k: tasks[k][0]):
            name, path, source = tasks[k]
            try:
                content = make(source, path)
                index.add(path, made_of(source), content)
                outcomes[k] = Outcome(name, path, source, content)
            except ManifoldError as error:
                outcomes[k] = Outcome(printable(name), path, source, failure=str(error))
    return outcomes
