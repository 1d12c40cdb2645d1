"""The command `manifold`, also as `python -m manifold`."""

import sys


def run() -> None:
    """Load the command line and run it. Loading takes a moment, and Ctrl-C in it is no error."""
    try:
        from manifold.cli import main

        main.run()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    run()
