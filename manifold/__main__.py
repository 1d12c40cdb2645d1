"""The command `manifold`, also as `python -m manifold`."""

import sys


def run(arguments: list[str] | None = None) -> None:
    """Load the command line and run it. Loading takes a moment, and Ctrl-C in it is no error."""
    try:
        from manifold.cli import main

        main.run(arguments)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    run()
