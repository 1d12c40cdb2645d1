"""Commands in one process of their own, where some packages cannot be imported, or others are installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

_PROGRAM = """
import contextlib, io, json, sys
# zarr asks by `importlib.util.find_spec` for fsspec, which gives None then.
sys.modules.update(dict.fromkeys(json.loads(sys.argv[1])))
from manifold.cli.main import run
exec(sys.argv[3])
for words in json.loads(sys.argv[2]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            run(words)
            status = 0
        except SystemExit as leaving:
            status = leaving.code
    print(json.dumps([status, out.getvalue(), err.getvalue()]))
exec(sys.argv[4])
"""


def run_together(
    missing: Sequence[str],
    commands: Mapping[str, Sequence[str]],
    folder: Path,
    first: str = "",
    last: str = "",
    installed: Path | None = None,
) -> dict[str, list]:
    """Return status, stdout and stderr of each command, run in a folder one after the other.

    `first` and `last` are code that runs before and after them. `last` prints one line of JSON, whose value is returned
    under its name. `installed` is a folder of packages that can be imported.
    """
    words = json.dumps(missing), json.dumps(list(commands.values()))
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *words, first, last],
        cwd=folder, capture_output=True, text=True, check=True, env=with_packages(installed),
    )  # fmt: skip
    names = (*commands, "last") if last else commands
    return dict(zip(names, map(json.loads, done.stdout.splitlines()), strict=True))


def with_packages(folder: Path | None) -> dict[str, str]:
    """Return the environment of a process that can import the packages in a folder."""
    path = os.pathsep.join(filter(None, (str(folder or ""), os.environ.get("PYTHONPATH"))))
    return os.environ | {"PYTHONPATH": path}
