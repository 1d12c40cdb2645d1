"""The command line, called in this process."""

from __future__ import annotations

import io
import shlex
import warnings
from contextlib import redirect_stderr, redirect_stdout

from manifold.__main__ import run


class CommandError(Exception):
    """A command that ended with an error; its message is what it printed."""


def command(line: str) -> str:
    """Run a command in the current folder; what it printed on stdout. Raises CommandError if it fails."""
    out, err = io.StringIO(), io.StringIO()
    status: object = 0
    with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
        try:
            run(shlex.split(line))
        except SystemExit as left:
            status = left.code
    if status:
        said = err.getvalue().strip().splitlines()
        raise CommandError(said[-1] if said else f"status {status}")
    return out.getvalue()
