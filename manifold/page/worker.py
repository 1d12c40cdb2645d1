"""The process that runs the commands of a served page, one after the other; imported modules stay loaded.

It reads pickled calls, a command's name and arguments, from stdin. It writes lines of JSON to stdout:
`[done, total, what]` during the work, then `{"result": ...}` or `{"failure": ...}`.
"""

from __future__ import annotations

import json
import os
import pickle
import select
import shutil
import signal
import sys
import threading
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

from manifold.core import progress
from manifold.core.errors import in_words

INPUTS = "MANIFOLD_EXPLORE_INPUTS"
"""Environment variable of the server's temporary folder, which the worker removes if the server was killed."""


def serve(run: Callable[[str, dict[str, Any]], dict[str, Any]]) -> None:
    """Answer calls until there are no more; end without an answer if memory is exhausted.

    `run` calls a command by its name with arguments, and returns plain values.
    """
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # libraries' output is no reply
    threading.Thread(target=_end_with_server, args=(replies.fileno(),), daemon=True).start()

    def reply(content: Any) -> None:
        print(json.dumps(content, allow_nan=False), file=replies, flush=True)

    while True:
        try:
            command, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            _remove_inputs()
            return
        try:
            with progress.listen(lambda *step: reply(step)):
                result = run(command, arguments)
            reply({"result": result})
        except MemoryError:
            return
        except (Exception, SystemExit) as error:  # the latter from another package
            reply({"failure": in_words(error)})


def _end_with_server(replies: int) -> None:
    """Terminate this process and its children once nothing reads its replies, because the server was killed."""
    poll = select.poll()
    poll.register(replies, 0)  # which tells only that the other end was closed
    poll.poll()
    _remove_inputs()
    os.killpg(os.getpgrp(), signal.SIGTERM)


def _remove_inputs() -> None:
    """Remove the temporary folder of a server that was killed."""
    if folder := os.environ.get(INPUTS):
        shutil.rmtree(folder, ignore_errors=True)


def _main() -> None:
    from manifold.page.commands import COMMANDS

    for command in COMMANDS.values():  # imported while nobody waits
        if not select.select([sys.stdin], [], [], 0.0)[0]:
            resolve_name(command.function)
    serve(lambda name, arguments: resolve_name(COMMANDS[name].function)(**arguments).to_json())


if __name__ == "__main__":
    _main()
