"""`python -m manifold` is the command `manifold`."""

from manifold.cli.main import run

run()
