"""Where a library may be: its path, and not inside another one."""

from __future__ import annotations

import os
from pathlib import Path

from manifold.errors import UsageError


def resolved(library: Path | str) -> Path:
    """The library's real absolute path, so that staging lands on its file system and not beside a link.

    Raises:
        UsageError: it names an unknown user's home folder, or its links go in a circle.
    """
    try:
        return Path(library).expanduser().resolve()
    except (OSError, RuntimeError) as error:
        raise UsageError(f"{library}: {str(error).rstrip('.')}; name another path") from error


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
