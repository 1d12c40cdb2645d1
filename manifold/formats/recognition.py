"""Recognises the kind of a file or folder, which determines how commands open it.

A text that a user gives may also name a material of a library or a point on a map; see
`estimate.sources.parse_source`.
"""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import Any

from manifold.core import disk, shipped
from manifold.core.disk import begins_with
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.picture_bytes import KINDS
from manifold.core.stores import METADATA, is_zipped_library
from manifold.formats.tensor_file import is_tensor_file
from manifold.registries import CONVERTED_SUFFIXES, FIT_SUFFIX

MODEL_MAGIC = b"manifold model\r\n"
_RGL_SUFFIXES = (".bsdf", ".bsdf.gz")
_SUFFIXES = (  # of readings; `.json` is mostly something else
    ".xlsx", ".xls", ".cxf",
    *(suffix for suffixes in CONVERTED_SUFFIXES.values() for suffix in suffixes if suffix != ".json"),
)  # fmt: skip
_RESULTS_HEAD = b"name,file,"  # of the tables that batches write
_FIT_HEAD = b'{\n  "format": "manifold fit"'


class Kind(StrEnum):
    """The kinds of paths; the values are texts for messages."""

    NOTHING = "no file or folder"
    LIBRARY = "a library"
    FOLDER = "a folder"
    RGL = "an RGL file"
    MODEL = "a model"
    FIT = "the JSON of a fit"
    READINGS = "a file of an instrument or of another program"
    PICTURE = "a picture"
    OTHER = "a file of another kind"


def kind_of(path: Path) -> Kind:
    """Return the kind of a path from its content or, if the content does not determine it, from its name."""
    if is_library(path):
        return Kind.LIBRARY
    if not os.path.exists(path):
        return Kind.NOTHING
    if os.path.isdir(path):
        return Kind.FOLDER
    if is_tensor_file(path):
        return Kind.RGL
    if begins_with(path, MODEL_MAGIC):
        return Kind.MODEL
    if begins_with(path, _FIT_HEAD):
        return Kind.FIT
    if is_readings(path):
        return Kind.READINGS
    if begins_with(path, *KINDS):
        return Kind.PICTURE
    if path.suffix in (".h5", ".hdf5"):
        return Kind.MODEL
    if is_fit(path):
        return Kind.FIT
    return Kind.RGL if is_rgl(path) else Kind.OTHER


def is_library(path: Path) -> bool:
    """Return whether a path is a folder or zip file that looks like a library, the built-in one, or an address."""
    return shipped.is_elsewhere(path) or os.path.isfile(path / METADATA) or is_zipped_library(path)


def is_rgl(path: Path) -> bool:
    """Return whether a file is an RGL file, compressed by gzip or not, or has the name of one, whatever its content."""
    return path.name.lower().endswith(_RGL_SUFFIXES) or is_tensor_file(path)


def is_fit(path: Path) -> bool:
    """Return whether a file is the JSON of a fit, or has the name of one."""
    return path.name.endswith(FIT_SUFFIX) or begins_with(path, _FIT_HEAD)


_ENGINE_SUFFIXES = (".glb", ".mtlx", ".usda")


def read_export(path: Path) -> dict[str, Any] | None:
    """Return the content of a JSON file that `manifold export` wrote; None for other files."""
    if path.suffix.lower() != ".json" or is_fit(path) or not os.path.isfile(path):
        return None
    try:
        content = disk.read_json(path, "the JSON of an export")
    except ManifoldError:
        return None
    is_export = isinstance(content, dict) and {"target", "material", "parameters", "errors"} <= content.keys()
    return content if is_export else None


def require_no_export(path: Path) -> None:
    """Raise UsageError for a file that `manifold export` wrote for an engine, because it cannot be read back."""
    is_json = read_export(path) is not None
    if path.suffix.lower() not in _ENGINE_SUFFIXES and not is_json:
        return
    of_file = f"; `manifold info {path.name}` states that of this file" if is_json else ""
    raise UsageError(
        f"{path}: a file for engines, which cannot be read back, expected its material; `manifold export MATERIAL "
        f"--target NAME --picture` states the error of the export and draws both{of_file}"
    )


def is_rendered(path: Path) -> bool:
    """Return whether a file can be rendered directly, because it is an RGL file or a fit."""
    return is_rgl(path) or is_fit(path)


def is_readings(path: Path) -> bool:
    """Return whether a file looks like an instrument's file; other text files may look like one as well."""
    from manifold.formats import registry  # what only asks for RGL files does without

    return path.suffix != ".md" and os.path.isfile(path) and registry.identify(path) is not None


def counts_as_readings(path: Path) -> bool:
    """Return whether a file of a folder is to be read as readings, because of its content or its suffix.

    A damaged file then fails with a reason instead of being left out. Hidden files, lock files of Excel, RGL files and
    tables of results do not count by their suffix.
    """
    try:
        if is_readings(path):
            return True
    except ManifoldError:  # raised again where it is read
        pass
    is_other = path.name.startswith((".", "~$")) or is_tensor_file(path) or begins_with(path, _RESULTS_HEAD)
    return path.name.lower().endswith(_SUFFIXES) and not is_other
