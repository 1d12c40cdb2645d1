"""Files that appear under their name only when they are whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from manifold.errors import UsageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, renamed to it when the block ends without an error.

    Raises:
        UsageError: the folder does not exist, or the file cannot be written.
    """
    partial = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(
            f"{path}: cannot write this file ({reason}); check the folder, or name another"
        ) from error
    finally:
        with suppress(OSError):  # what could not be made need not be removed
            partial.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8. Raises: as `replacing`."""
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
