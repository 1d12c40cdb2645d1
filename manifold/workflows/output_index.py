"""Index of an output folder: which file was made from what, so that a later run makes only what is missing."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from manifold import __version__
from manifold.errors import FileFormatError, UsageError
from manifold.library.identity import file_sha256
from manifold.system import atomic, small_files

_MOST = 1 << 30  # bytes of an index: a row has about two thousand


class OutputIndex:
    """The JSON file beside the outputs of a run of many, as a context: it is whole when the block ends.

    Until then what is added stands in a journal beside it, a line each, so that a run that is killed has lost nothing,
    and one of many files does not write all it knows for each.

    Args:
        folder: of the outputs; made if missing.
        what: they are, in the plural; `exports` makes `exports.json`, and meanwhile `exports.journal`.
    Raises:
        UsageError: the folder cannot be made, or is a file.
        FileFormatError: there is another file of the index's name.
    """

    def __init__(self, folder: Path, what: str) -> None:
        if folder.exists() and not folder.is_dir():
            raise UsageError(f"{folder}: is a file, expected a folder for {what}; name another")
        folder.mkdir(parents=True, exist_ok=True)
        self._path, self._what = folder / f"{what}.json", what
        self._journal = folder / f"{what}.journal"
        self._entries = self._read()

    def __enter__(self) -> OutputIndex:
        return self

    def __exit__(self, *raised: object) -> None:
        if not self._journal.is_file():
            return
        self._entries = self._read()  # with what another run may have added
        content = {"format": self._format, "program": f"manifold {__version__}", self._what: self._entries}
        atomic.write_text(self._path, json.dumps(content, indent=1, allow_nan=False) + "\n")
        self._journal.unlink(missing_ok=True)

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
            UsageError: the journal cannot be written.
        """
        entry = {"made_of": self._stamped(made_of), "file_sha256": file_sha256(path), "result": result}
        self._entries[path.name] = entry
        # A line of its own, whatever a killed run has left of one.
        line = "\n" + json.dumps([path.name, entry], allow_nan=False) + "\n"
        try:
            with self._journal.open("ab") as journal:
                journal.write(line.encode())
                journal.flush()
                os.fsync(journal.fileno())
        except OSError as error:
            raise UsageError(f"{self._journal}: cannot write this file ({error.strerror})") from error

    @property
    def _format(self) -> str:
        return f"manifold {self._what}"

    def _stamped(self, made_of: dict[str, Any]) -> dict[str, Any]:
        return json.loads(json.dumps(made_of | {"program": f"manifold {__version__}"}))

    def _read(self) -> dict[str, Any]:
        entries: dict[str, Any] = {}
        if self._path.is_file():
            content = small_files.read_json(self._path, f"the index of a folder of {self._what}", _MOST)
            if not isinstance(content, dict) or content.get("format") != self._format:
                raise FileFormatError(
                    f"{self._path}: not an index of {self._what}; name another folder, or remove it"
                )
            known = content.get(self._what)
            entries |= known if isinstance(known, dict) else {}
        return entries | self._journalled()

    def _journalled(self) -> dict[str, Any]:
        """The entries of a run that has not ended or was killed; its last line may be incomplete."""
        entries: dict[str, Any] = {}
        if self._journal.is_file():
            text = small_files.read_bytes(self._journal, advice="remove it", most=_MOST)
            for line in text.splitlines():
                with suppress(ValueError, TypeError):
                    name, entry = json.loads(line)
                    entries[str(name)] = entry
        return entries
