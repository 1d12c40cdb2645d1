"""Fixtures that many tests share."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many slow tests were left out."""
    left = [item for item in terminalreporter.stats.get("deselected", ()) if item.get_closest_marker("slow")]
    if left:
        terminalreporter.write_line(f"{len(left)} slow tests left to `make test-slow`")


@pytest.fixture
def rng() -> np.random.Generator:
    """The one source of randomness in tests."""
    return np.random.default_rng(20261121)


@pytest.fixture
def run(capsys, monkeypatch):
    """The command in this process, in a given folder: status, stdout, stderr."""
    from manifold.cli.main import run as run_main

    def call(*arguments, cwd):
        monkeypatch.chdir(cwd)
        with pytest.raises(SystemExit) as caught:
            run_main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return caught.value.code or 0, captured.out, captured.err

    return call


def real_rgl_folder() -> Path | None:
    """The folder of real RGL files: `MANIFOLD_RGL_DIR`, else `../shared/rgl/real`, else None."""
    named = os.environ.get("MANIFOLD_RGL_DIR")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "rgl" / "real"
    return folder if folder.is_dir() and any(folder.glob("*.bsdf")) else None


def real_rgl_files() -> list[Path]:
    """The real RGL files at hand, possibly none."""
    folder = real_rgl_folder()
    return [] if folder is None else sorted(folder.glob("*.bsdf"))
