"""Starts the command `manifold`; `python -m manifold` does the same."""

import gc
import signal
import sys
from importlib.util import find_spec
from pathlib import Path

import manifold


def run(arguments: list[str] | None = None) -> None:
    """Load the command line and run it.

    Ctrl-C while the program loads ends it without a traceback; SIGTERM is treated as Ctrl-C.
    """
    # Imports make objects that stay: to look for garbage after every 700 of them takes a twentieth of a prediction.
    gc.set_threshold(100_000)
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        # In a checkout that is not installed, the command line lies beside this package.
        if find_spec("manifold.cli") is None:
            manifold.__path__.append(str(Path(__file__).parents[1]))
        from manifold.cli import main

        main.run(arguments)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    run()
