"""An output replaces what is there, but never an input of the same command, nor anything in a library."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from manifold.errors import UsageError

_OUTPUTS = ("output", "picture", "markdown", "json")  # parameters that are files or folders to be written
_parameters: ContextVar[Mapping[str, Any]] = ContextVar("_parameters")


def check_all(parameters: Mapping[str, Any]) -> None:
    """Check the outputs among the parameters of the command that begins to run; raises UsageError as `checked`."""
    _parameters.set(parameters)
    for name in _OUTPUTS:
        if isinstance(path := parameters.get(name), Path) and (name, str(path)) != ("json", "-"):
            checked(path, name)


def or_default(output: Path | None, default: str) -> Path:
    """The output that was named, or a default that is checked as if it had been named."""
    return checked(Path(default)) if output is None else output


def checked(path: Path, name: str = "output") -> Path:
    """A path that the running command may write to.

    Args:
        path: a file or folder.
        name: of the parameter that it stands for.
    Raises:
        UsageError: it is another file of the command, or lies in a library.
    """
    from manifold.library.identity import require_outside_libraries

    if str(path) == "-":
        raise UsageError("-: this command writes a file; name one (only --json takes -)")
    require_outside_libraries(path, into=path.is_dir())
    for other, values in _parameters.get().items():
        for value in values if isinstance(values, list | tuple) else [values]:
            is_file = isinstance(value, str | Path) and (other in _OUTPUTS or os.path.isfile(value))
            if other != name and is_file and os.path.realpath(value) == os.path.realpath(path):
                if other in _OUTPUTS:
                    raise UsageError(f"{path}: named for --{other} and for --{name}; name two files")
                raise UsageError(f"{path}: is an input of this command; name another output")
    return path
