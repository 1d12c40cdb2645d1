"""RGL files: tensor files of a material database, read into validated `BsdfFile` records, and written back.

Source: Dupuy & Jakob 2018; what is checked is what Mitsuba's `measured` plugin relies on.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from manifold.errors import FileFormatError, UsageError
from manifold.formats.tensor_file import (
    WRITE_REMEDY,
    ErrorContext,
    check_tensors,
    printable,
    read_tensors,
    shape_text,
    write_tensors,
)
from manifold.records import Array, BsdfFile

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
_AT_LEAST_TWO = ("theta_i", "sigma", "ndf", "vndf", "luminance")  # what is interpolated needs two nodes


def read_bsdf(path: Path | str) -> BsdfFile:
    """Read and validate an RGL file, spectral or RGB, isotropic or anisotropic.

    Args:
        path: a `.bsdf` tensor file. The material's name is the file's without `_spec.bsdf` or `_rgb.bsdf`.
    Returns:
        A record whose arrays are read-only views of the mapped file.
    Raises:
        FileFormatError: the file is missing, of another format, damaged, or lacks what an RGL file must hold;
            the message names the file and the field.
    """
    path = Path(path)
    tensors = read_tensors(path)
    _check(tensors, ErrorContext(path))
    known = {name: tensors[name] for name in _FIELDS if name in tensors}
    return BsdfFile(
        name=material_name(path),
        # Surrogates carry bytes that are not UTF-8 through to writing.
        description=known["description"].tobytes().decode("utf-8", "surrogateescape"),
        version=tuple(int(part) for part in known["version"]),
        phi_i_rad=known["phi_i"],
        theta_i_rad=known["theta_i"],
        wavelengths_nm=known.get("wavelengths"),
        sigma=known["sigma"],
        ndf=known["ndf"],
        vndf=known["vndf"],
        luminance=known["luminance"],
        spectra=known["spectra"] if "spectra" in known else known["rgb"],
        jacobian=bool(known["jacobian"][0]),
        valid=known["valid"],
        extra=MappingProxyType({name: a for name, a in tensors.items() if name not in _FIELDS}),
    )


def rgl_wavelengths_nm() -> Array:
    """The 195 band centres of the RGL spectral files in nm, shape (195,): 358.63 to 1001.89, evenly spaced.

    Rounded to float32, as the files hold them, and returned as float64.
    """
    return np.linspace(358.63, 1001.89, 195).astype(np.float32).astype(np.float64)


def material_name(path: Path) -> str:
    """Name of the material in a file: `satin_gold` for `satin_gold_spec.bsdf`."""
    name = path.name.removesuffix(".bsdf")
    for suffix in ("_spec", "_rgb"):
        name = name.removesuffix(suffix)
    return name


def write_bsdf(path: Path | str, file: BsdfFile) -> None:
    """Write an RGL file, atomically; reading it back gives every field byte for byte.

    Raises:
        FileFormatError: the record is not what a file may hold; nothing is written.
        UsageError: the file cannot be written, or `file` is no such record.
    """
    path = Path(path)
    if not isinstance(file, BsdfFile):
        raise UsageError(
            f"{path}: found {type(file).__name__}, expected a BsdfFile; manifold.brdf.goniometer.measure makes one of "
            "a BRDF"
        )
    context = ErrorContext(path, WRITE_REMEDY)
    spectral = file.wavelengths_nm is not None
    tensors: dict[str, Array] = {
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
    for name in file.extra:
        if name in _FIELDS:
            raise context.error("stands among the extra fields, expected another name there", name)
    tensors |= file.extra
    check_tensors(tensors, context)
    _check(tensors, context)
    write_tensors(path, tensors)


def _stored(name: str, value: str | tuple[int, ...], dtype: str, context: ErrorContext) -> Array:
    """A text or numbers of a record as the array that the file holds."""
    try:
        if isinstance(value, str):
            return np.frombuffer(value.encode("utf-8", "surrogateescape"), dtype=dtype)
        return np.array(value, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise context.error(f"cannot be stored as {np.dtype(dtype).name} ({error})", name) from None


def _check(tensors: Mapping[str, Array], context: ErrorContext) -> None:
    """Everything that reading and writing rely on.

    Raises:
        FileFormatError: names the file and the first field that is not as expected.
    """
    _check_layout(tensors, context)
    _check_grids(tensors, context)
    _check_values(tensors, context)


def _check_layout(tensors: Mapping[str, Array], context: ErrorContext) -> None:
    """Presence, dtype and shape of every field."""
    spectral = "spectra" in tensors
    if spectral == ("rgb" in tensors):
        found = printable(", ".join(tensors), 200) or "none"
        raise context.error(
            f"found fields {found}, expected either 'spectra' or 'rgb' among them",
            remedy="it is no RGL file, or a damaged one: fetch it again",
        )
    sizes: dict[str, int] = {}
    for name, (dtype, axes) in _FIELDS.items():
        if name == ("rgb" if spectral else "spectra"):
            continue
        if name == "wavelengths" and not spectral:
            if name in tensors:
                raise context.error("stands beside 'rgb', expected it beside 'spectra' only", name)
            continue
        if name not in tensors:
            raise context.error("is missing, expected in every RGL file", name)
        array = tensors[name]
        if array.dtype != np.dtype(dtype):
            raise context.error(f"has dtype {array.dtype.name}, expected {np.dtype(dtype).name}", name)
        if axes is not None:
            _check_shape(name, array.shape, axes, sizes, context)
    cells = tensors["luminance"].size
    if tensors["valid"].size not in (cells, -(-cells // 8)):
        raise context.error(
            f"has {tensors['valid'].size} bytes, expected one bit ({-(-cells // 8)}) or one byte ({cells}) per cell",
            "valid",
        )


def _check_shape(
    name: str,
    shape: tuple[int, ...],
    axes: tuple[str | int, ...],
    sizes: dict[str, int],
    context: ErrorContext,
) -> None:
    """Match a shape against axes; the first field with a letter fixes its size for the others."""
    if len(shape) != len(axes):
        words = ", ".join(_AXIS_WORDS.get(a, str(a) or "any") if isinstance(a, str) else str(a) for a in axes)
        raise context.error(f"has shape {shape_text(shape)}, expected {len(axes)} axes ({words})", name)
    for axis, (letter, size) in enumerate(zip(axes, shape, strict=True)):
        expected = letter if isinstance(letter, int) else sizes.setdefault(letter, size) if letter else size
        if size != expected:
            word = f" ({_AXIS_WORDS[letter]})" if isinstance(letter, str) else ""
            raise context.error(
                f"has shape {shape_text(shape)}, expected {expected} along axis {axis}{word}", name
            )
    required = 2 if name in _AT_LEAST_TWO else 1
    interpolated = shape[2:] if name in ("vndf", "luminance") else shape
    if name != "description" and min(interpolated) < required:
        raise context.error(
            f"has shape {shape_text(shape)}, expected at least {required} along every axis", name
        )


def _check_grids(tensors: Mapping[str, Array], context: ErrorContext) -> None:
    """Angles and wavelengths: finite, increasing, in range."""
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
        if not np.all(np.isfinite(values)):
            raise _bad_value(name, values, ~np.isfinite(values), "finite values", context)
        falls = np.flatnonzero(values[1:] <= values[:-1])
        if falls.size:
            k = int(falls[0])
            raise context.error(
                f"goes from {values[k]:.6g} to {values[k + 1]:.6g} at index {k}, expected increasing values",
                name,
            )
        if values[0] < low or values[-1] > high:
            raise context.error(f"runs from {values[0]:.4g} to {values[-1]:.4g}, expected {words}", name)


def _check_values(tensors: Mapping[str, Array], context: ErrorContext) -> None:
    """Tables: finite, of the right sign, and densities that are not zero everywhere."""
    for name in ("sigma", "ndf", "vndf", "luminance", "spectra", "rgb"):
        if name in tensors:
            low, high = tensors[name].min(), tensors[name].max()  # NaN wins in both: no temporaries needed
            if not (np.isfinite(low) and np.isfinite(high)):
                raise _bad_value(name, tensors[name], ~np.isfinite(tensors[name]), "finite values", context)
            if name in ("ndf", "vndf") and low < 0:
                raise _bad_value(name, tensors[name], tensors[name] < 0, "no negative densities", context)
            if name == "sigma" and low <= 0:
                raise _bad_value(name, tensors[name], tensors[name] <= 0, "positive areas", context)
    peaks = tensors["vndf"].max(axis=(2, 3))
    if np.any(peaks <= 0):
        phi, theta = (int(k[0]) for k in np.nonzero(peaks <= 0))
        raise context.error(f"is zero everywhere at incidence ({phi}, {theta}), expected a density", "vndf")
    if tensors["jacobian"][0] > 1:
        raise context.error(f"is {int(tensors['jacobian'][0])}, expected 0 or 1", "jacobian")


def _bad_value(name: str, values: Array, bad: Array, expected: str, context: ErrorContext) -> FileFormatError:
    """The error of a table with bad values: the first of them, where it stands, and how many there are."""
    index = tuple(int(k) for k in np.unravel_index(int(np.argmax(bad)), bad.shape))
    count = int(np.count_nonzero(bad))
    others = f" and {count - 1} more values are bad" if count > 1 else ""
    return context.error(f"is {values[index]:.4g} at index {index}{others}, expected {expected}", name)
