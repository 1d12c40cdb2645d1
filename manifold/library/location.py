"""Where files may be written: not inside a library."""

from __future__ import annotations

import os
from pathlib import Path

from manifold.errors import UsageError


def require_outside_libraries(path: Path, *, into: bool = False) -> None:
    """Raise UsageError where a file or folder to be written lies in a library.

    Args:
        path: the file or folder.
        into: whether files are to be written into it, so that it must be no library itself.
    """
    real = Path(os.path.realpath(path))
    folders = [real, *real.parents] if into else real.parents
    libraries = [folder for folder in folders if (folder / "zarr.json").is_file()]
    if libraries:  # the last one is the library, others are its groups
        raise UsageError(
            f"{path}: in the library {libraries[-1]}, which other files would damage; name another path"
        )
