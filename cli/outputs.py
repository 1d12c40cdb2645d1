"""Checks outputs: they may replace existing files, but no input of the command, and nothing in a library."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import typer

from manifold.core import disk
from manifold.core.errors import UsageError


class _Running(NamedTuple):
    """The command that runs: values of its parameters, and which of these are written."""

    parameters: Mapping[str, Any]
    written: frozenset[str]


_running: ContextVar[_Running] = ContextVar("_running")


def written(*names: str, help: str, metavar: str = "FILE", hidden: bool = False, at_end: bool = False) -> Any:
    """Return an option for an annotation that names a file or folder to be written; see `check_all`.

    A file that is written `at_end` may lie in the folder that the command makes.
    """
    option = typer.Option(*names, help=help, metavar=metavar, hidden=hidden)
    option.is_written, option.at_end = True, at_end
    return option


def check_all(command: Callable[..., Any], parameters: Mapping[str, Any]) -> None:
    """Check the outputs among the parameters of a command before it runs; raises UsageError like `checked`.

    The JSON of an earlier run is removed, so that a command that fails leaves no JSON.
    """
    hints = get_type_hints(command, include_extras=True)
    found = {
        name: each
        for name, hint in hints.items()
        for each in getattr(hint, "__metadata__", ())
        if getattr(each, "is_written", False)
    }
    _running.set(_Running(parameters, frozenset(found)))
    for name in sorted(found):
        # Versions of Typer differ in whether paths are paths here already.
        if (given := parameters.get(name)) is not None and (name, str(given)) != ("json", "-"):
            path, folder = checked(Path(given), name), Path(parameters.get("output") or ".")
            if found[name].at_end and (path.parent != folder or path.parent.is_dir()):
                disk.require_writable(path)
    results = parameters.get("json")
    if results is not None and str(results) != "-":
        Path(os.path.realpath(results)).unlink(missing_ok=True)


def or_default(output: Path | None, default: str) -> Path:
    """Return the named output, or a default that is checked in the same way."""
    return checked(Path(default)) if output is None else output


def checked(path: Path, name: str = "output") -> Path:
    """Return a path to which the running command may write, after checking it; the error names the parameter."""
    from manifold.library.identity import require_outside_libraries

    if str(path) == "-":
        raise UsageError("-: this command writes a file; name one (only --json takes -)")
    require_outside_libraries(path, into=path.is_dir())
    running = _running.get()
    for other, values in running.parameters.items():
        for value in values if isinstance(values, list | tuple) else [values]:
            is_file = isinstance(value, str | Path) and (other in running.written or os.path.isfile(value))
            if other != name and is_file and os.path.realpath(value) == os.path.realpath(path):
                if other in running.written:
                    raise UsageError(f"{path}: named for --{other} and for --{name}; name two files")
                raise UsageError(f"{path}: is an input of this command; name another output")
    return path
