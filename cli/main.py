"""The command `manifold`: its subcommands, exit status, and error messages."""

from __future__ import annotations

import io
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from functools import partial
from itertools import pairwise
from typing import Any

import typer

from manifold import __version__
from manifold.core.errors import ManifoldError, UsageError, extension_of, in_words
from manifold.core.extras import missing
from manifold.core.names import printable
from manifold.core.progress import display_with

from . import application, terminal

_COORDINATES = re.compile(r"-[\d.][-+\d.eE]*(,[-+\d.eE]+)+")  # such as -0.3,1.2, which is no option
_COORDINATE = re.compile(r"-[\d.][-+\d.eE]*")  # of a latent in one dimension, unless it is an option's value
_OPTIONS = re.compile(r"No such option: (\S+) \(Possible options: ([^)]*)\)")
_NUMBER = re.compile(r"-?[\d.][-+\d.eE]*")
_EXTRA = re.compile(r"Got unexpected extra argument\S* \(([-\d.eE+ ]+)\)")
_ALIKE = 0.75  # share of the letters of an option that a mistyped one has
_EXIT_ERROR = 1
_EXIT_USAGE = 2
_EXIT_INTERRUPTED = 130
_EXIT_PIPE = 141  # as a shell reports a program that SIGPIPE ended
_Mistyped: Any = typer.BadParameter.__base__  # Click's UsageError, which newer versions of Typer bring along


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"manifold {__version__}")
        raise typer.Exit


@application.app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    strict: bool = typer.Option(
        False,
        "--strict",
        help="Treat warnings as errors, and write no file whose albedo exceeds 1.05. Other diagnostics do not count "
        "as warnings.",
    ),
) -> None:
    """Options of every command; the last two are taken out of the arguments by `run`, wherever they stand."""


def __getattr__(name: str) -> Any:
    """Return `app`, the application with all commands; a run imports only the module of its command."""
    if name == "app":
        application.load(application.COMMANDS)
        return application.app
    raise AttributeError(f"module {__name__} has no attribute {name}")


def run(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status.

    The status is 0 for success, 2 for a wrong command line, 1 for any other error (such as a file that is missing,
    damaged or cannot be written), 130 if interrupted, and 141 if the reader of the output has ended.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    debug, strict = "--debug" in arguments, "--strict" in arguments
    arguments = [argument for argument in arguments if argument not in ("--debug", "--strict")]
    application.Command.shows_all = "--help-all" in arguments
    arguments = ["--help" if argument == "--help-all" else argument for argument in arguments]
    command = next((argument for argument in arguments if not argument.startswith("-")), None)
    # Behind a blank, which all that takes coordinates ignores, they are no option to Click.
    arguments = [
        f" {argument}" if _is_latent(argument, before) else argument
        for before, argument in pairwise(["", *arguments])
    ]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for terminals that cannot show all that files say
    terminal.begin(strict)
    display_with(terminal.display)
    if strict:
        warnings.simplefilter("always", UserWarning)  # also what this process was warned of before
    if strict or not debug:
        warnings.showwarning = partial(_show_warning, strict)
    try:
        # A shell's variable that is not set; as a path, Python takes it for the current folder.
        if "" in arguments:
            raise UsageError("found an empty argument; give a value or leave it out")
        group = application.app.only(command)
        status = group(args=arguments or ["--help"], prog_name="manifold", standalone_mode=False)
        sys.stdout.flush()
    except KeyboardInterrupt:
        status = _EXIT_INTERRUPTED
    except (Exception, SystemExit) as error:
        if _is_interruption(error):
            status = _EXIT_INTERRUPTED
        elif isinstance(error, BrokenPipeError | SystemExit) and extension_of(error) is None:  # Click's exit
            # What reads the output has ended, as `head` does; nothing is printed about it at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            status = _EXIT_PIPE
        else:
            if debug:
                traceback.print_exc()
            print(f"manifold: {_one_line(_message(error, command, arguments))}", file=sys.stderr)
            is_usage = isinstance(error, UsageError | _Mistyped) and not isinstance(error, OSError)
            status = _EXIT_USAGE if is_usage else _EXIT_ERROR
    if status == _EXIT_INTERRUPTED:
        print("manifold: interrupted; finished outputs are kept", file=sys.stderr)
    sys.exit(status or 0)


def _is_latent(argument: str, before: str) -> bool:
    """Return whether an argument that begins with a minus is a latent, not an option or an option's value."""
    is_behind_option = before.startswith("-") and _COORDINATE.fullmatch(before) is None
    single = _COORDINATE.fullmatch(argument) is not None and not is_behind_option
    return single or _COORDINATES.fullmatch(argument) is not None


def _is_interruption(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused the error; compiled code and imports wrap `KeyboardInterrupt` in other errors."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _message(error: BaseException, name: str | None, arguments: Sequence[str]) -> str:
    if isinstance(error, _Mistyped):
        called = f"manifold {name}" if name in application.COMMANDS else "manifold"
        command = getattr(error.ctx, "command_path", called)  # an option without its value has no context
        found = error.format_message().replace("Value error, ", "").rstrip(".")  # words of Typer's
        found = re.sub(r"\. Did you mean (.*\?)$", r" (did you mean \1)", found)
        found = _OPTIONS.sub(_like_options, found)
        if (extra := _EXTRA.fullmatch(found)) is not None:
            stripped = [argument.strip() for argument in arguments]
            found = found.replace("( ", "(") + _joined_coordinates(extra[1].split(), stripped)
        return f"{found}; see `{command} --help`"
    if isinstance(error, ModuleNotFoundError):
        error = missing(error) or error
    return in_words(error)


def _joined_coordinates(extra: list[str], arguments: list[str]) -> str:
    """Return a hint that joins coordinates which stand apart, such as 0.3 0.2; empty if no number precedes them."""
    first = next((k for k in range(len(arguments)) if arguments[k : k + len(extra)] == extra), 0)
    if first == 0 or _NUMBER.fullmatch(arguments[first - 1]) is None:
        return ""
    return f"; write coordinates with a comma: {','.join([arguments[first - 1], *extra])}"


def _like_options(found: re.Match[str]) -> str:
    """Return the options that Typer takes for a mistyped one, if they are hardly different."""
    near = get_close_matches(found[1], found[2].split(", "), cutoff=_ALIKE)
    return f"No such option: {found[1]}" + (f" (did you mean {', '.join(near)}?)" if near else "")


def _one_line(message: object) -> str:
    return printable(" ".join(str(message).split()))


def _show_warning(strict: bool, message: Warning | str, category: type[Warning], *_: object) -> None:
    """Show warnings of this package as one line, or raise them as errors; those of libraries are for developers."""
    if not category.__module__.startswith("manifold"):
        return
    if strict:
        raise ManifoldError(f"{_one_line(message)} (an error because of --strict)")
    terminal.warned.append(_one_line(message))
    print(f"manifold: warning: {_one_line(message)}", file=sys.stderr)
