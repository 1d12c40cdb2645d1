"""The installation, for bug reports: versions, extras, and the renderer."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from typing import Any

from manifold import __version__
from manifold.core import extras
from manifold.core.errors import RendererError
from manifold.render import backend

_REQUIRED = ("numpy", "scipy", "scikit-learn", "h5py", "zarr", "colour-science", "typer")


def describe() -> tuple[dict[str, object], dict[str, Any]]:
    """Return rows for people, and a JSON document, of versions, extras and the renderer."""
    packages = {name: metadata.version(name) for name in _REQUIRED}
    optional = extras.versions()
    rows: dict[str, object] = {
        "manifold": __version__,
        "Python": f"{platform.python_version()}, {platform.platform()}, {os.cpu_count()} cores",
        "packages": [f"{name} {version}" for name, version in packages.items()],
    }
    for extra, versions in optional.items():
        rows[f"extra {extra}"] = [f"{name} {version or '(missing)'}" for name, version in versions.items()]
    document: dict[str, Any] = {"python": platform.python_version(), "packages": packages, "extras": optional}
    try:
        backend.mitsuba()  # raises if it cannot be used
        chosen = backend.choose()
        rows["renderer"] = f"Mitsuba variants {chosen.kind}, libLLVM {chosen.library or 'none'}"
        if chosen.advice is not None:
            rows["advice"] = chosen.advice
        document["renderer"] = chosen.to_json()
    except RendererError as error:
        rows["renderer"], document["renderer"] = str(error), None
    return rows, document
