"""The command `manifold`: its subcommands, exit status, and error messages."""

from __future__ import annotations

import io
import os
import sys
import traceback
import warnings
from importlib import import_module
from typing import TextIO

import typer

from manifold import __version__
from manifold.errors import ManifoldError, UsageError
from manifold.system import interrupts

from . import terminal
from .application import app

_EXIT_ERROR = 1
_EXIT_USAGE = 2
_EXIT_INTERRUPTED = 130


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"manifold {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    strict: bool = typer.Option(
        False,
        "--strict",
        help="Treat warnings as errors. Diagnostics of predictions are results, not warnings.",
    ),
) -> None:
    """Options of every command; the last two are taken out of the arguments by `run`, wherever they stand."""


for _commands in (
    "library", "model", "report", "picture", "explore", "fit", "export", "render", "budget", "chart", "stability",
    "completion", "instrument",
):  # fmt: skip  # in the order of the help
    import_module(f".{_commands}_commands", __package__)


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its status.

    0: done. 2: the command line cannot be followed. 1: anything else that went wrong, such as a model or a library
    that is missing or damaged. 130: interrupted.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    debug, strict = "--debug" in arguments, "--strict" in arguments
    arguments = [argument for argument in arguments if argument not in ("--debug", "--strict")]
    # A closed stream is None, and a write to it would be an error of its own.
    sys.stdout, sys.stderr = sys.stdout or _nowhere(), sys.stderr or _nowhere()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for terminals that cannot show all that files say
    terminal.warned.clear()
    if strict:
        warnings.simplefilter("always", UserWarning)  # also what this process was warned of before
    if strict or not debug:
        warnings.showwarning = _refuse_warning if strict else _show_warning
    try:
        app(args=arguments, prog_name="manifold")
    except SystemExit as leaving:  # typer turns Ctrl-C into this status, without a word
        if leaving.code == _EXIT_INTERRUPTED:
            _say_interrupted()
        raise
    except BrokenPipeError:
        # The reader of our output has left, which is its right; keep the interpreter quiet about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(_EXIT_ERROR)
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        if interrupts.is_interruption(error):
            _say_interrupted()
            sys.exit(_EXIT_INTERRUPTED)
        print(f"manifold: {_one_line(_message(error))}", file=sys.stderr)
        sys.exit(_EXIT_USAGE if isinstance(error, UsageError) else _EXIT_ERROR)


def _message(error: BaseException) -> str:
    if isinstance(error, ManifoldError):
        return str(error)
    if isinstance(error, MemoryError):
        return "out of memory; close other programs, or use a smaller library"
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}; check the path, its permissions and the free space"
    if _is_in_cache_of_numba(error):
        return "the cache of compiled functions is damaged; delete the folders __pycache__ of manifold"
    return f"internal error: {type(error).__name__}: {error}; run again with --debug and report it"


def _is_in_cache_of_numba(error: BaseException) -> bool:
    frames = traceback.extract_tb(error.__traceback__)
    return any(frame.filename.endswith(os.path.join("numba", "core", "caching.py")) for frame in frames)


def _say_interrupted() -> None:
    print("manifold: interrupted; finished outputs are kept", file=sys.stderr)


def _one_line(message: object) -> str:
    return terminal.printable(" ".join(str(message).split()))


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:  # type: ignore[no-untyped-def]
    """Warnings of this package as one line; those of libraries are for developers."""
    if category.__module__.startswith("manifold"):
        terminal.warned.append(_one_line(message))
        print(f"manifold: warning: {_one_line(message)}", file=sys.stderr)


def _refuse_warning(message, category, filename, lineno, file=None, line=None) -> None:  # type: ignore[no-untyped-def]
    """Warnings of this package as errors."""
    if category.__module__.startswith("manifold"):
        raise ManifoldError(f"{_one_line(message)} (an error because of --strict)")


def _nowhere() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")
