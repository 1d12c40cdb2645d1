"""Recognition of the kind of a path, by which commands and workflows open it.

Words that users write may also name a material of a library or a place on a map: see `estimate.sources.parse_source`.
"""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path

from manifold.core.disk import begins_with
from manifold.core.picture_bytes import KINDS
from manifold.formats.tensor_file import is_tensor_file

MODEL_MAGIC = b"manifold model\r\n"
FIT_SUFFIX = ".fit.json"
_RGL_SUFFIXES = (".bsdf", ".bsdf.gz")
_FIT_HEAD = b'{\n  "format": "manifold fit"'


class Kind(StrEnum):
    """Kinds of paths, in words."""

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
    """Return the kind of a path by its content, by its name only if the content does not tell."""
    if not os.path.exists(path):
        return Kind.NOTHING
    if os.path.isdir(path):
        return Kind.LIBRARY if is_library(path) else Kind.FOLDER
    if is_tensor_file(path):
        return Kind.RGL
    if begins_with(path, MODEL_MAGIC) or path.suffix in (".h5", ".hdf5"):
        return Kind.MODEL
    if is_fit(path):
        return Kind.FIT
    if is_readings(path):
        return Kind.READINGS
    if begins_with(path, *KINDS):
        return Kind.PICTURE
    return Kind.RGL if is_rgl(path) else Kind.OTHER


def is_library(path: Path) -> bool:
    """Return whether a path is a folder that looks like a library."""
    return os.path.isfile(path / "zarr.json")


def is_rgl(path: Path) -> bool:
    """Return whether a file is an RGL file, compressed by gzip or not, or is named like one, whatever it holds."""
    return path.name.endswith(_RGL_SUFFIXES) or is_tensor_file(path)


def is_fit(path: Path) -> bool:
    """Return whether a file is the JSON of a fit, or is named like one."""
    return path.name.endswith(FIT_SUFFIX) or begins_with(path, _FIT_HEAD)


def is_rendered(path: Path) -> bool:
    """Return whether a file is rendered as it is: an RGL file or a fit."""
    return is_rgl(path) or is_fit(path)


def is_readings(path: Path) -> bool:
    """Return whether a file's content is an instrument's; texts that describe files beside them may look like it."""
    from manifold.formats import registry  # what only asks for RGL files does without

    return path.suffix != ".md" and os.path.isfile(path) and registry.identify(path) is not None
