"""Identifies the materials of a library by name, by the hash of the file, and by the hash of the content."""

from __future__ import annotations

import hashlib
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core import disk
from manifold.core.defaults import COMPACT_TOLERANCE
from manifold.core.errors import UsageError
from manifold.core.records import AnyArray, Array, BsdfFile, origin_of
from manifold.formats.recognition import is_library


def require_outside_libraries(path: Path, *, into: bool = False) -> None:
    """Raise UsageError if an output path lies in a library; with `into`, also if the path itself is a library."""
    real = Path(os.path.realpath(path))
    folders = [real, *real.parents] if into else real.parents
    libraries = [folder for folder in folders if is_library(folder)]
    if libraries:  # the last one is the library, others are its groups
        raise UsageError(
            f"{path}: lies in the library {libraries[-1]}, which this file would damage; name another path"
        )


_MOST_BYTES = 1 << 60  # largest size of a material; more is damage


@dataclass(frozen=True)
class Accuracy:
    """Errors of a compact material.

    Attributes:
        tolerance: largest `ball` that was allowed.
        ball: mean CIEDE2000 over a ball between the compact and the original material.
        cube_root: relative error of cube roots, `||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`.
    """

    tolerance: float
    ball: float
    cube_root: float


@dataclass(frozen=True)
class MaterialInfo:
    """Metadata of a material in a library.

    Attributes:
        source_file: name of the imported file, without its folder.
        sha256: hash of the imported file.
        content_sha256: hash of the stored fields; `Library.verify` computes it again.
        pipeline_version: version of the pipeline that wrote the file; RGB files say (1, 0).
        is_synthetic: whether the description marks the file as synthetic.
        shape: shape of the spectra, (P, T, B, H, W), as in `BsdfFile`.
        bytes: size of all arrays together, before any compression.
        accuracy: errors of a compact material; None if the material is stored unchanged.
        rotation_rad: azimuth by which the specimen was turned; see `BsdfFile`.
    """

    name: str
    source_file: str
    sha256: str
    content_sha256: str
    pipeline_version: tuple[int, ...]
    description: str
    is_synthetic: bool
    shape: tuple[int, ...]
    bytes: int
    accuracy: Accuracy | None = None
    rotation_rad: float = 0.0

    @property
    def origin(self) -> str:
        """Return `measured`, `synthetic`, `predicted`, `completed` or `reconstructed`; see `records.origin_of`."""
        found = origin_of(self.description)
        return "synthetic" if found == "measured" and self.is_synthetic else found

    @property
    def is_isotropic(self) -> bool:
        """Return whether one incident azimuth was measured, by the rule of `BsdfFile.is_isotropic`."""
        return self.shape[0] <= 2


def origins_in_words(materials: Iterable[MaterialInfo]) -> str:
    """Return a text that counts materials that were not measured, such as `3 of them synthetic`; it may be empty."""
    origins = Counter(material.origin for material in materials)
    del origins["measured"]
    return ", ".join(f"{count} of them {origin}" for origin, count in origins.most_common())


def describe(
    file: BsdfFile,
    source_file: str,
    sha256: str,
    compact: tuple[Mapping[str, AnyArray], Accuracy] | None = None,
) -> MaterialInfo:
    """Return the metadata that a library stores about a file.

    If a compact form is given, the hash, size and errors in the metadata refer to it.
    """
    arrays, accuracy = compact or (None, None)
    return MaterialInfo(
        name=file.name,
        source_file=source_file,
        sha256=sha256,
        content_sha256=content_sha256(file, source_file, sha256, arrays),
        pipeline_version=tuple(int(part) for part in file.version),
        description=file.description,
        is_synthetic="synthetic" in file.description.lower(),
        shape=tuple(file.spectra.shape),
        bytes=sum(array.nbytes for array in present_arrays(file).values())
        + sum(array.nbytes for array in file.extra.values()),
        accuracy=accuracy,
        rotation_rad=file.rotation_rad,
    )


def present_arrays(file: BsdfFile) -> dict[str, Array]:
    """Return the array fields that a file has, by name; an RGB file has no `wavelengths_nm`."""
    from manifold.library.layout import FIELDS

    return {name: getattr(file, name) for name in FIELDS if getattr(file, name) is not None}


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a regular file, in hexadecimal."""
    disk.require_regular(path, "check the path")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def content_sha256(
    file: BsdfFile, source_file: str, sha256: str, arrays: Mapping[str, AnyArray] | None = None
) -> str:
    """Return the hash of everything that a library stores of a material; it does not depend on the chunks.

    The SHA-256, in hexadecimal, covers one line of JSON (name, source file, hash of the file, description, version,
    jacobian, and the rotation if there is one), then the fields and the extra fields as in `hash_arrays`.
    """
    version = [int(part) for part in file.version]
    header = [file.name, source_file, sha256, file.description, version, bool(file.jacobian)]
    header += [file.rotation_rad] if file.rotation_rad else []
    digest = hashlib.sha256(json.dumps(header).encode())
    if arrays is None:
        arrays = present_arrays(file) | {f"extra {name}": array for name, array in file.extra.items()}
    for name, array in arrays.items():
        _update(digest, name, array)
    return digest.hexdigest()


def hash_arrays(arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 of arrays, over the name, dtype, shape and little-endian bytes (C order) of each."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        _update(digest, name, np.asarray(array))
    return digest.hexdigest()


def is_material_name(name: str) -> bool:
    """Return whether a name is valid both as a group of a zarr store and as a folder."""
    is_sound = re.fullmatch(r"(?!\.|__)[^/\\]{1,200}", name) and name.isprintable()
    return bool(is_sound) and name != "zarr.json"


def require_material_name(name: str) -> None:
    """Raise UsageError unless a name for a new material is valid on every operating system."""
    is_reserved = re.fullmatch(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?", name)
    is_portable = not re.search(r'[<>:"|?*\\]|[ .]$', name) and unicodedata.is_normalized("NFC", name)
    if not is_material_name(name) or is_reserved or not is_portable or len(name.encode()) > 200:
        raise UsageError(
            f"{name!r} cannot be the name of a material on every system; name it with letters, digits, - and _"
        )


def require_tolerance(tolerance: float) -> None:
    """Raise UsageError unless the tolerance of compact materials is a number above 0."""
    if not 0.0 < tolerance < np.inf:
        raise UsageError(
            f"tolerance is {tolerance:g}, expected a number above 0, such as {COMPACT_TOLERANCE}"
        )


def alike(name: str) -> str:
    """Return a key that is equal for names that differ only in case or Unicode form, as some file systems do."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def info_of(name: str, values: Mapping[str, Any]) -> MaterialInfo:
    """Return the metadata of a material from the attributes of its zarr group."""
    optional = ("name", "accuracy", "rotation_rad")
    known = {field.name: values[field.name] for field in fields(MaterialInfo) if field.name not in optional}
    accuracy, rotation_rad = values.get("accuracy"), float(values.get("rotation_rad", 0.0))
    expected = {
        "source_file": str,
        "sha256": str,
        "content_sha256": str,
        "description": str,
        "is_synthetic": bool,
    }
    for key, kind in (expected | {"bytes": int, "shape": list, "pipeline_version": list}).items():
        if type(known[key]) is not kind or (kind is list and any(type(v) is not int for v in known[key])):
            raise ValueError(f"attribute '{key}' is no {kind.__name__}")
    if not all(0 <= count <= _MOST_BYTES for count in (known["bytes"], *known["shape"])):
        raise ValueError("attribute 'bytes' or 'shape' is out of range")
    if len(known["shape"]) != 5:
        raise ValueError(f"attribute 'shape' has {len(known['shape'])} entries, expected 5")
    if not abs(rotation_rad) <= np.pi:
        raise ValueError("attribute 'rotation_rad' is out of range")
    lists = {key: tuple(known[key]) for key in ("shape", "pipeline_version")}
    if accuracy is not None:
        accuracy = Accuracy(*(float(accuracy[field.name]) for field in fields(Accuracy)))
    return MaterialInfo(name=name, accuracy=accuracy, rotation_rad=rotation_rad, **(known | lists))


def _update(digest: Any, name: str, array: Array) -> None:
    plain = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    digest.update(f"\n{name} {plain.dtype.str} {array.shape}\n".encode())
    digest.update(plain.reshape(-1).view(np.uint8).data)
