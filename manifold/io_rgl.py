"""Reads and writes RGL files, the tensor files of the RGL material database, as validated `BsdfFile` records.

The checks cover everything that Mitsuba's `measured` plugin relies on.

Source: Dupuy & Jakob 2018.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np

from manifold.core.errors import FileFormatError, UsageError
from manifold.core.names import printable
from manifold.core.records import AnyArray, BsdfFile, Mask
from manifold.formats.foreign import MUELLER, MUELLER_FIELDS
from manifold.formats.tensor_file import is_tensor_file, read_tensors, shape_text, write_tensors
from manifold.formats.text import ErrorContext

# What an RGL file must hold: dtype and axes per field; an axis is a number, or a letter that all fields share.
_FIELDS: dict[str, tuple[str, tuple[str | int, ...] | None]] = {
    "version": ("<u4", (2,)),
    "description": ("u1", ("",)),
    "phi_i": ("<f4", ("P",)),
    "theta_i": ("<f4", ("T",)),
    "wavelengths": ("<f4", ("B",)),
    "sigma": ("<f4", ("", "")),
    "ndf": ("<f4", ("", "")),
    "vndf": ("<f4", ("P", "T", "", "")),
    "luminance": ("<f4", ("P", "T", "H", "H")),
    "spectra": ("<f4", ("P", "T", "B", "H", "H")),
    "rgb": ("<f4", ("P", "T", 3, "H", "H")),
    "jacobian": ("u1", (1,)),
    "valid": ("u1", None),  # its size counts, packed bits have no axes of their own
}
_AXIS_WORDS = {"P": "phi_i", "T": "theta_i", "B": "wavelengths", "H": "side of the outgoing grid"}
_AT_LEAST_TWO = ("theta_i", "sigma", "ndf", "vndf", "luminance")  # interpolated fields need two nodes


def read_bsdf(source: Path | str | bytes | BinaryIO) -> BsdfFile:
    """Read and validate an RGL file, spectral or RGB, isotropic or anisotropic.

    Args:
        source: path of a `.bsdf` tensor file, which may be compressed by gzip; or the file's content as bytes; or a
            binary file object. The material is named after the file, without `_spec.bsdf`, `_rgb.bsdf` and `.gz`;
            content without a file name gets the name `material`.

    Returns:
        A record whose arrays are read-only views of the mapped file or of the content.

    Raises:
        UsageError: `source` has another type.
        MissingFileError, FileAccessError: the file is missing, or cannot be read.
        FileFormatError: the file has another format, is damaged, or lacks a required field; the message names the
            file and the field.
    """
    path, content = _path_and_content(source)
    if content is None and os.path.isfile(path) and not is_tensor_file(path):
        from manifold.formats import registry

        known = registry.identify(path)
        if known is not None:
            raise FileFormatError(
                f"{printable(path.name, 255)}: {known.name}, expected an RGL file; make one by `manifold complete` "
                "from a few readings, or by `manifold convert` from a table or whole hemispheres of readings"
            )
    tensors = read_tensors(path, content)
    _check(tensors, ErrorContext(path, "the file is damaged: fetch it again"))
    fields = {name: tensors[name] for name in _FIELDS if name in tensors}
    return BsdfFile(
        name=material_name(path),
        # Surrogates carry bytes that are not UTF-8 through to writing.
        description=fields["description"].tobytes().decode("utf-8", "surrogateescape"),
        version=tuple(int(part) for part in fields["version"]),
        phi_i_rad=fields["phi_i"],
        theta_i_rad=fields["theta_i"],
        wavelengths_nm=fields.get("wavelengths"),
        sigma=fields["sigma"],
        ndf=fields["ndf"],
        vndf=fields["vndf"],
        luminance=fields["luminance"],
        spectra=fields["spectra"] if "spectra" in fields else fields["rgb"],
        jacobian=bool(fields["jacobian"][0]),
        valid=fields["valid"],
        extra=MappingProxyType({name: a for name, a in tensors.items() if name not in _FIELDS}),
    )


def _path_and_content(source: Path | str | bytes | BinaryIO) -> tuple[Path, bytes | None]:
    """Return the path of an RGL file, and its content unless it is to be read from there."""
    if isinstance(source, Path | str):
        return Path(source), None
    content = source if isinstance(source, bytes) else getattr(source, "read", bool)()
    if not isinstance(content, bytes):
        raise UsageError(
            f"found {type(source).__name__}, expected the path of a .bsdf file, its bytes, or a file opened with 'rb'"
        )
    name = getattr(source, "name", None)
    return Path(name if isinstance(name, str) else "material"), content


def rgl_wavelengths_nm() -> AnyArray:
    """Return the 195 band centres of the RGL spectral files in nm, shape (195,): 358.63 to 1001.89, evenly spaced.

    The values are float64, rounded to the float32 values that the files hold.
    """
    return np.linspace(358.63, 1001.89, 195).astype(np.float32).astype(np.float64)


def material_name(path: Path) -> str:
    """Return the material name that a file name implies: `satin_gold` for `satin_gold_spec.bsdf`."""
    name = path.name.removesuffix(".gz").removesuffix(".bsdf")
    for suffix in ("_spec", "_rgb"):
        name = name.removesuffix(suffix)
    return name


def write_bsdf(path: Path | str, file: BsdfFile) -> None:
    """Write an RGL file atomically; `read_bsdf` restores every field byte for byte.

    Raises:
        FileFormatError: a field of the record is not valid in an RGL file; nothing is written.
        UsageError: the file cannot be written, or `file` is not a `BsdfFile`.
    """
    path = Path(path)
    if not isinstance(file, BsdfFile):
        raise UsageError(
            f"{path}: found {type(file).__name__}, expected a BsdfFile; goniometer.measure makes one from a BRDF"
        )
    context = ErrorContext(path, "correct the record; nothing was written")
    tensors = _tensors(file, context)
    _check(tensors, context)
    write_tensors(path, tensors)


def require_sound(file: BsdfFile) -> None:
    """Raise FileFormatError unless the record is valid; compiled code relies on the shapes of its arrays."""
    context = ErrorContext(Path(file.name), "correct the record")
    _check(_tensors(file, context), context)


def _tensors(file: BsdfFile, context: ErrorContext) -> dict[str, AnyArray]:
    """Return the fields of a record as a file holds them."""
    spectral = file.wavelengths_nm is not None
    tensors: dict[str, AnyArray] = {
        "version": _stored("version", file.version, "<u4", context),
        "description": _stored("description", file.description, "u1", context),
        "phi_i": file.phi_i_rad,
        "theta_i": file.theta_i_rad,
        **({"wavelengths": file.wavelengths_nm} if file.wavelengths_nm is not None else {}),
        "sigma": file.sigma,
        "ndf": file.ndf,
        "vndf": file.vndf,
        "luminance": file.luminance,
        "spectra" if spectral else "rgb": file.spectra,
        "jacobian": _stored("jacobian", (bool(file.jacobian),), "u1", context),
        "valid": file.valid,
    }
    if reserved := _FIELDS.keys() & file.extra.keys():
        raise context.error(
            "is reserved, but is the name of an extra field; choose another name", field=min(reserved)
        )
    return {**tensors, **file.extra}


def _stored(name: str, value: str | tuple[int, ...], dtype: str, context: ErrorContext) -> AnyArray:
    """Return a text or numbers of a record as the array that the file holds."""
    try:
        if isinstance(value, str):
            return np.frombuffer(value.encode("utf-8", "surrogateescape"), dtype=dtype)
        return np.array(value, dtype=dtype)
    except (ValueError, OverflowError) as error:
        raise context.error(f"cannot be stored as {np.dtype(dtype).name} ({error})", field=name) from None


def _check(tensors: Mapping[str, AnyArray], context: ErrorContext) -> None:
    """Raise FileFormatError for the first invalid field."""
    _check_layout(tensors, context)
    _check_grids(tensors, context)
    _check_values(tensors, context)


def _check_layout(tensors: Mapping[str, AnyArray], context: ErrorContext) -> None:
    """Check that every field is present and has the right dtype and shape."""
    if set(MUELLER_FIELDS) <= set(tensors):
        raise context.error(
            f"found {MUELLER}, expected an RGL file",
            remedy="render it with Mitsuba's plugin measured_polarized, or write its elements M[..., 0, 0] as a table",
        )
    spectral = "spectra" in tensors
    if spectral == ("rgb" in tensors):
        raise context.error(
            f"found fields {', '.join(tensors)[:200]}, expected either 'spectra' or 'rgb' among them",
            remedy="it is not an RGL file, or it is damaged: fetch it again",
        )
    if not spectral and "wavelengths" in tensors:
        raise context.error("found with 'rgb', expected only with 'spectra'", field="wavelengths")
    sizes: dict[str, int] = {}
    for name, (dtype, axes) in _FIELDS.items():
        if name in (("rgb",) if spectral else ("spectra", "wavelengths")):
            continue
        if name not in tensors:
            raise context.error("is missing, expected in every RGL file", field=name)
        array = tensors[name]
        if array.dtype != np.dtype(dtype):
            raise context.error(f"has dtype {array.dtype.name}, expected {np.dtype(dtype).name}", field=name)
        expected = None if axes is None else _expected_shape(name, array.shape, axes, sizes)
        if expected is not None:
            raise context.error(f"has shape {shape_text(array.shape)}, expected {expected}", field=name)
    cells, size = tensors["luminance"].size, tensors["valid"].size
    if size not in (cells, -(-cells // 8)):
        raise context.error(
            f"has {size} bytes, expected one bit ({-(-cells // 8)}) or one byte ({cells}) per cell",
            field="valid",
        )


def _expected_shape(
    name: str, shape: tuple[int, ...], axes: tuple[str | int, ...], sizes: dict[str, int]
) -> str | None:
    """Describe the shape that is expected, or return None if it fits; the first field with a letter fixes its size."""
    if len(shape) != len(axes):
        return f"{len(axes)} axes ({', '.join(_AXIS_WORDS.get(str(a), str(a) or 'any') for a in axes)})"
    for axis, (letter, size) in enumerate(zip(axes, shape, strict=True)):
        expected = letter if isinstance(letter, int) else sizes.setdefault(letter, size) if letter else size
        if size != expected:
            word = f" ({_AXIS_WORDS[letter]})" if isinstance(letter, str) else ""
            return f"{expected} along axis {axis}{word}"
    least = 0 if name == "description" else 2 if name in _AT_LEAST_TWO else 1
    interpolated = shape[2:] if name in ("vndf", "luminance") else shape
    return f"at least {least} along every axis" if min(interpolated) < least else None


def _check_grids(tensors: Mapping[str, AnyArray], context: ErrorContext) -> None:
    """Check that angles and wavelengths are finite, increasing and in range."""
    slack = 1e-3  # single precision puts pi / 2 and pi beyond themselves
    ranges = {
        "phi_i": (-2.0 * np.pi - slack, 2.0 * np.pi + slack, "radians within one turn"),
        "theta_i": (-slack, 0.5 * np.pi + slack, "radians from 0 to pi / 2"),
        "wavelengths": (np.finfo(np.float32).tiny, 1e6, "positive nanometres"),
    }
    for name, (low, high, words) in ranges.items():
        if name not in tensors:
            continue
        values = tensors[name]
        _require(np.isfinite(values), values, "finite values", name, context)
        _require(np.diff(values, prepend=-np.inf) > 0, values, "increasing values", name, context)
        if values[0] < low or values[-1] > high:
            raise context.error(
                f"runs from {values[0]:.4g} to {values[-1]:.4g}, expected {words}", field=name
            )


def _check_values(tensors: Mapping[str, AnyArray], context: ErrorContext) -> None:
    """Check that tables are finite and have the right sign, and that no density is zero everywhere."""
    for name in ("sigma", "ndf", "vndf", "luminance", "spectra", "rgb"):
        values = tensors.get(name)
        if values is None:
            continue
        if not np.all(np.isfinite((values.min(), values.max()))):  # NaN wins in both: no temporaries needed
            _require(np.isfinite(values), values, "finite values", name, context)
        if name in ("ndf", "vndf"):
            _require(values >= 0, values, "no negative densities", name, context)
        if name == "sigma":
            _require(values > 0, values, "positive areas", name, context)
    peaks = tensors["vndf"].max(axis=(2, 3))
    _require(peaks > 0, peaks, "a density that is not zero everywhere", "vndf", context)
    if tensors["jacobian"][0] > 1:
        raise context.error(f"is {int(tensors['jacobian'][0])}, expected 0 or 1", field="jacobian")


def _require(good: Mask, values: AnyArray, expected: str, name: str, context: ErrorContext) -> None:
    """Raise FileFormatError for the first value that is not good."""
    if not np.all(good):
        index = tuple(int(k) for k in np.unravel_index(int(np.argmin(good)), good.shape))
        raise context.error(f"is {values[index]:.4g} at index {index}, expected {expected}", field=name)
