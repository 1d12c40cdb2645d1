"""Optional packages: the extra that installs each, and the error if one is missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from manifold.core.errors import MissingPackageError

EXTRAS = {
    "plots": ("matplotlib", "PIL"),
    "page": ("jsonschema", "anywidget", "traitlets", "PIL"),
    "render": ("mitsuba", "drjit", "flip_evaluator", "jsonschema", "PIL"),
    "instruments": ("openpyxl", "xlrd", "PIL"),
    "photographs": ("OpenImageIO", "rawpy", "PIL"),
    "fetch": ("pooch", "requests"),
    "cluster": ("distributed",),
    "remote": ("fsspec", "aiohttp"),
    "frames": ("pandas", "xarray"),
}
"""Modules that each extra of `pip install 'brdf-manifold[EXTRA]'` installs; errors name the first such extra."""

_DISTRIBUTIONS = {"PIL": "pillow", "flip_evaluator": "flip-evaluator"}


def require(module: str) -> Any:
    """Import and return an optional module.

    Raises:
        MissingPackageError: the module is not installed; the message names the extra.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise missing(error) or error from None


def missing(error: ModuleNotFoundError) -> MissingPackageError | None:
    """Return the error that names the extra for a module that was not found; None if no extra installs it."""
    package = (error.name or "").partition(".")[0]
    for extra, modules in EXTRAS.items():
        if package in modules:
            name = _DISTRIBUTIONS.get(package, package)
            return MissingPackageError(f"{name} is not installed; pip install 'brdf-manifold[{extra}]'")
    return None


def versions() -> dict[str, dict[str, str | None]]:
    """Return the installed version of every optional package by extra; None for a missing package."""
    return {
        extra: {name: _version(name) for name in (_DISTRIBUTIONS.get(module, module) for module in modules)}
        for extra, modules in EXTRAS.items()
    }


def _version(distribution: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version  # parses mail, which takes a tenth of a help

    try:
        return version(distribution)
    except PackageNotFoundError:
        return None
