"""Where the repository and the real measured files are."""

from __future__ import annotations

import os
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]


def real_rgl_folder() -> Path | None:
    """The folder of real RGL files: `MANIFOLD_RGL_DIR`, else `../shared/rgl/real`, else None."""
    named = os.environ.get("MANIFOLD_RGL_DIR")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "rgl" / "real"
    return folder if folder.is_dir() and any(folder.glob("*.bsdf")) else None


def real_rgl_files() -> list[Path]:
    """The real RGL files at hand, possibly none."""
    folder = real_rgl_folder()
    return [] if folder is None else sorted(folder.glob("*.bsdf"))
