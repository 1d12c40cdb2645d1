"""Protection of files: commands never overwrite inputs, contents of a library, or files of another kind."""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any

import typer

from manifold.errors import UsageError

from . import mistyped

_NAMES = ("output", "picture", "markdown", "json")  # of parameters that are files to be written
_HEAD = 1 << 16
_JSON_FORMATS = {("fit", "output"): b"fit", ("calibrate", "output"): b"colour correction"}
_JSON_FORMAT = re.compile(rb'\{\s*"format": "manifold ([a-z ]+)"')  # reports have none
_given: ContextVar[tuple[str, dict[str, Any]] | None] = ContextVar("_given", default=None)
"""The name and the parameters of the command that runs, unless --force is among them."""
_PICTURES = {".png": b"\x89PNG", ".exr": b"\x76\x2f\x31\x01", ".pdf": b"%PDF", ".svg": b"<svg"}

Force = Annotated[bool, typer.Option("--force", help="Allow overwriting inputs and files of another kind.")]


class GuardedTyper(typer.Typer):
    """A Typer whose commands look at what their outputs would replace, and have `--force`."""

    def command(self, *args: Any, **kwargs: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """As `typer.Typer.command`."""
        register = super().command(*args, **{"cls": mistyped.Command} | kwargs)
        return lambda function: register(guarded(function))


def guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    """A command that first calls `require_replaceable` with its own parameters."""
    if not any(name in function.__annotations__ for name in _NAMES):
        return function
    signature = inspect.signature(function, eval_str=True)  # which Typer then need not do
    parameters = list(signature.parameters.values())
    is_own = "force" in signature.parameters
    if not is_own:
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters.append(inspect.Parameter("force", keyword, default=False, annotation=Force))

    @functools.wraps(function)
    def run(**values: Any) -> Any:
        if not values["force"]:
            require_replaceable(function.__name__, values)
        before = _given.set(None if values["force"] else (function.__name__, dict(values)))
        if not is_own:
            del values["force"]
        try:
            return function(**values)
        finally:
            _given.reset(before)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


def or_default(output: Path | None, default: str) -> Path:
    """The output that was named, which `guarded` has looked at, or else a default, looked at here."""
    return unnamed("output", Path(default)) if output is None else output


def unnamed(name: str, path: Path) -> Path:
    """An output of the running command that its user did not name, looked at beside all that was.

    Args:
        name: the parameter that it stands for.
    Raises:
        UsageError: as `require_replaceable`.
    """
    if (given := _given.get()) is not None:
        command, values = given
        values[name] = path
        require_replaceable(command, values)
    return path


def require_unused(json: Path) -> None:
    """Raise UsageError where the running command has written another output than its JSON to this file."""
    if (given := _given.get()) is not None:
        require_replaceable(given[0], {"json": json})


def require_replaceable(command: str, values: Mapping[str, Any]) -> None:
    """Raise UsageError where an output of a command would destroy something.

    Args:
        command: its name.
        values: its parameters by name; `output`, `picture`, `markdown` and `json`, and the model of `embed`, are what
            it writes, everything else that is there under a path is what it reads.
    """
    from manifold.library.location import require_outside_libraries

    names = (*_NAMES, "model") if command == "embed" else _NAMES
    outputs = {name: values[name] for name in names if isinstance(values.get(name), Path)}
    for name in [name for name, path in outputs.items() if str(path) == "-"]:
        if name != "json":
            raise UsageError("-: this command writes a file; name one (only --json takes -)")
        del outputs[name]
    inputs = [path for name, value in values.items() if name not in outputs for path in _paths(value)]
    targets: dict[str, str] = {}
    for name, path in outputs.items():
        target = os.path.realpath(path)
        other = targets.setdefault(target, name)
        if other != name:
            raise UsageError(f"{path}: named for --{other} and for --{name}; name two files")
        require_outside_libraries(path, into=path.is_dir())
        if not path.is_file():
            continue
        if any(os.path.realpath(source) == target or _is_same(source, path) for source in inputs):
            raise UsageError(f"{path}: is an input of this command; name another output, or use --force")
        if not _is_own_kind(command, name, path, values.get("to")):
            raise UsageError(
                f"{path}: exists, and was not written by this command; name another file, or use --force"
            )


def _paths(value: Any) -> Iterator[Path]:
    """The files among a parameter's values."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from _paths(item)
    elif isinstance(value, str | Path) and value:
        try:
            if Path(value).is_file():
                yield Path(value)
        except (OSError, ValueError):  # no path at all
            return


def _is_same(a: Path, b: Path) -> bool:
    try:
        return a.samefile(b)
    except OSError:
        return False


def _is_own_kind(command: str, name: str, path: Path, to: str | None = None) -> bool:
    """Whether a file is one that this parameter of the command writes; empty files belong to no command.

    Args:
        to: the format that `convert` writes, where it was named.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except OSError:
        return True  # whoever writes it says why not
    if not head:
        return True
    if name == "model":
        return head.startswith(b"manifold model\r\n") or b"manifold-model" in head
    expected = _JSON_FORMATS.get((command, name))
    if name == "json" or expected is not None:
        found = _JSON_FORMAT.match(head)
        return b'"program": "manifold ' in head and (found[1] if found else None) == expected
    if name == "markdown":
        return b"manifold stability" in head
    if command == "explore":
        return b"<title>Material map</title>" in head
    if command == "convert" and (title := _instrument_format(path, to)) is not None:
        from manifold.formats import registry

        known = registry.identify(path)
        return known is not None and known.name == title
    if path.suffix.lower() == ".bsdf" or command == "export":
        return b" by manifold " in head
    magic = _PICTURES.get(path.suffix.lower())
    return magic is not None and (head.startswith(magic) or (path.suffix.lower() == ".svg" and magic in head))


def _instrument_format(output: Path, to: str | None) -> str | None:
    """The name of the format that `convert` would write, None for RGL files: they say who wrote them."""
    from manifold.workflows.conversion_targets import TARGETS, target_of

    target = target_of(output, to)
    return None if target is TARGETS["rgl"] else target.title
