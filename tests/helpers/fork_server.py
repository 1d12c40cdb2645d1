"""A process that has imported the package and runs scripts in forks of itself: each import would take a second."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PROGRAM = """
import json, os, sys, traceback
sys.path[:] = {path!r}
import manifold.library.importing
for line in sys.stdin:
    script, errors, count = json.loads(line)
    children = []
    for k in range(count):
        child = os.fork()
        if child == 0:
            try:
                exec(script, dict(__name__="__main__"))
            except BaseException:
                with open(errors + str(k), "w") as file:
                    traceback.print_exc(file=file)
                os._exit(1)
            os._exit(0)
        children.append(child)
    print(json.dumps(children), flush=True)
    print(json.dumps([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]), flush=True)
"""


class ForkServer:
    """Forks of one process; `start` and `wait` by turns."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self._process, self._errors = process, folder / "error"

    def start(self, script: str, count: int = 1) -> list[int]:
        """Run a script in some processes at once; their numbers."""
        for k in range(count):
            Path(f"{self._errors}{k}").unlink(missing_ok=True)
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([script, str(self._errors), count]) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def wait(self) -> list[int]:
        """The exit codes of the processes that were started, as of `subprocess`."""
        return self._answer()

    def error(self, k: int = 0) -> str:
        """The traceback of a process that has raised an error, else nothing."""
        path = Path(f"{self._errors}{k}")
        return path.read_text() if path.exists() else ""

    def _answer(self) -> list[int]:
        assert self._process.stdout is not None
        return json.loads(self._process.stdout.readline())


@contextmanager
def fork_server(folder: Path) -> Iterator[ForkServer]:
    """The process, which keeps errors in a folder, until the end of the block."""
    program = _PROGRAM.format(path=sys.path)
    arguments = [sys.executable, "-c", program]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield ForkServer(process, folder)
        assert process.stdin is not None
        process.stdin.close()
