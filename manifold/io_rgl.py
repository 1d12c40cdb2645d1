"""RGL tensor files: read into `BsdfFile` records by mapping, checked before use, and written back byte for byte.

    12 bytes "tensor_file\\0", u8 major = 1, u8 minor = 0, u32 number of fields; per field u16 length of the name,
    name, u16 ndim, u8 dtype, u64 offset in the file, u64 shape[ndim]; then the data. Little-endian throughout.

Source: Dupuy & Jakob 2018; what is checked beyond the layout is what Mitsuba's `measured` plugin relies on.
"""

from __future__ import annotations

import math
import mmap
import os
import stat
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from manifold import atomic
from manifold.errors import FileFormatError, UsageError
from manifold.records import Array, BsdfFile

MAGIC = b"tensor_file\0"
_PREAMBLE = struct.Struct("<12sBBI")
_SMALLEST_FIELD = 14  # bytes of a field's header: empty name, no axes
_MAX_AXES = 32  # numpy's own limit was this for decades; RGL files have at most 5
_MAX_FIELDS = 1024  # RGL files have 13; without a limit the names of a large damaged file fill the memory
_MAX_NAME = 0xFFFF  # bytes
_ALIGNMENT = 8
_SNIFFED = 8192  # bytes of another format's header that may hold the word that tells it

_DTYPES = {
    1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
_CODES = {np.dtype(name): code for code, name in _DTYPES.items()}

# Other formats that use the extension .bsdf, by how their files begin.
_FOREIGN = (
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"SCATFUN", "a Fourier BSDF of layerlab or pbrt-v3"),
    (b"version https://git-lfs", "a Git LFS pointer, not the file itself"),
)
_FOREIGN_WORDS = (
    (("<!doctype html", "<html"), "an HTML page, as failed downloads leave"),
    (("<windowelement", "<opticsdefinition", "<?xml"), "a Radiance / WINDOW BSDF (XML)"),
    # Mini-Diff files share most words with Zemax files; only theirs write the incidence as AOI.
    (("mini-diff", "minidiff", "reflet", "lighttools", "light tools", "\naoi"), "a Synopsys Mini-Diff BSDF"),
    (("spectralcontent", "scattertype", "sampleorientation", "samplerotation", "zemax"), "a Zemax BSDF"),
)


class _Reader:
    """Errors of one short line that name the file and, where there is one, the field, and say what to do."""

    def __init__(self, path: Path, remedy: str = "the file is damaged: fetch it again") -> None:
        self.path = path
        self.remedy = remedy  # what to do where an error says nothing better

    def error(self, found: str, field: str | None = None, remedy: str | None = None) -> FileFormatError:
        where = f"{_printable(self.path.name or str(self.path), 255)}: "
        if field is not None:
            where += f"field '{_printable(field)}' "
        return FileFormatError(f"{where}{found}; {remedy or self.remedy}")


def _printable(text: str, limit: int = 64) -> str:
    """The text on one line: what does not print as an escape, the end of a long text left out."""
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: limit + 1])
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def _shape_text(shape: tuple[int, ...]) -> str:
    """A shape as numpy writes it, cut off where a damaged header makes it long."""
    return str(shape) if len(shape) <= 8 else f"({', '.join(map(str, shape[:4]))}, ... {len(shape)} axes)"


def read_tensors(path: Path | str) -> dict[str, Array]:
    """The fields of a tensor file in the order of the file: read-only views of the mapped file.

    Args:
        path: any tensor file; nothing is assumed about its fields. It must not be shortened while the arrays
            live: the operating system ends a process that reads beyond the end of a mapped file. Replacing it
            by renaming, as `write_tensors` does, is safe.
    Raises:
        FileFormatError: no such file, another format, or a header that points outside the file.
    """
    path = Path(path)
    reader = _Reader(path)
    buffer = _map(path, reader)
    entries, header_end = _read_header(buffer, reader)
    _require_separate(entries, header_end, reader)
    return {entry.name: entry.view(buffer) for entry in entries}


@dataclass(frozen=True)
class _Entry:
    """One field's header."""

    name: str
    dtype: np.dtype
    shape: tuple[int, ...]
    offset: int

    @property
    def end(self) -> int:
        return self.offset + math.prod(self.shape) * self.dtype.itemsize

    def header(self) -> bytes:
        """As it stands in the file."""
        name = self.name.encode("utf-8")
        length, axes = struct.pack("<H", len(name)), struct.pack(f"<{len(self.shape)}Q", *self.shape)
        return length + name + struct.pack("<HBQ", len(self.shape), _CODES[self.dtype], self.offset) + axes

    def view(self, buffer: mmap.mmap) -> Array:
        """The field's data, without a copy unless the file does not align it."""
        count = math.prod(self.shape)
        # An empty field may point at the very end of the file, where frombuffer sees nothing to view.
        array = np.frombuffer(buffer, self.dtype, count, self.offset) if count else np.empty(0, self.dtype)
        if not array.flags.aligned:
            array = array.copy()
        array = array.reshape(self.shape)
        array.flags.writeable = False
        return array


def _map(path: Path, reader: _Reader) -> mmap.mmap:
    """The whole file as read-only memory."""
    try:
        # A pipe would block in open(), a device could go on for ever: only regular files are opened.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise reader.error(
                "is no regular file, expected an RGL tensor file", remedy="name the .bsdf file itself"
            )
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size < _PREAMBLE.size:
                raise reader.error(
                    f"has {size} bytes, expected an RGL tensor file",
                    remedy="it is empty or cut off: fetch it again",
                )
            return mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise reader.error(
            f"cannot be read ({reason}), expected an RGL tensor file",
            remedy="check the path and its permissions",
        ) from error


def _read_header(buffer: mmap.mmap, reader: _Reader) -> tuple[list[_Entry], int]:
    """All field headers, checked against the size of the file, and where they end."""
    size = len(buffer)
    magic, major, minor, count = _PREAMBLE.unpack_from(buffer)
    if magic != MAGIC:
        raise reader.error(
            f"found {_name_format(buffer[:_SNIFFED])}, expected an RGL tensor file (it begins with 'tensor_file')",
            remedy="only files of the RGL material database and its tools can be read",
        )
    if (major, minor) != (1, 0):
        raise reader.error(
            f"has tensor format {major}.{minor}, expected 1.0",
            remedy="convert it with the tool that wrote it",
        )
    if count * _SMALLEST_FIELD > size - _PREAMBLE.size:
        raise reader.error(f"announces {count} fields, more than its {size} bytes can hold")
    if count > _MAX_FIELDS:
        raise reader.error(f"announces {count} fields, expected at most {_MAX_FIELDS}")
    entries: list[_Entry] = []
    names: set[str] = set()
    position = _PREAMBLE.size
    for index in range(count):
        entry, position = _read_entry(buffer, position, index, reader)
        if entry.name in names:
            raise reader.error("appears twice, expected unique names", entry.name)
        names.add(entry.name)
        entries.append(entry)
    return entries, position


def _read_entry(buffer: mmap.mmap, position: int, index: int, reader: _Reader) -> tuple[_Entry, int]:
    """One field header and the position behind it."""
    size = len(buffer)
    shown = f"#{index + 1}"

    def take(format_: str) -> tuple[int, ...]:
        nonlocal position
        width = struct.calcsize(format_)
        if position + width > size:
            raise reader.error("has a header cut off by the end of the file, expected all of it", shown)
        values = struct.unpack_from(format_, buffer, position)
        position += width
        return values

    (length,) = take("<H")
    if position + length > size:
        raise reader.error(f"has a name of {length} bytes, more than the file holds", shown)
    try:
        name = buffer[position : position + length].decode("utf-8")
    except UnicodeDecodeError:
        raise reader.error("has a name that is not UTF-8, expected text", shown) from None
    shown = name
    position += length
    ndim, code, offset = take("<HBQ")
    if ndim > _MAX_AXES:
        raise reader.error(f"has {ndim} axes, expected at most {_MAX_AXES}", shown)
    if code not in _DTYPES:
        raise reader.error(f"has dtype {code}, expected 1 to 11", shown)
    entry = _Entry(name, np.dtype(_DTYPES[code]), take(f"<{ndim}Q"), offset)
    _check_entry(entry, reader, f"#{index + 1}")
    if entry.end > size:
        raise reader.error(
            f"with shape {_shape_text(entry.shape)} and dtype {entry.dtype.name} ends at byte {entry.end}, "
            f"but the file has {size}",
            shown,
            remedy="it is cut off or damaged: fetch it again",
        )
    return entry, position


def _check_entry(entry: _Entry, reader: _Reader, number: str) -> None:
    """What every field must satisfy to be written and read back: a name to print, a shape numpy can hold."""
    if not entry.name.isprintable():
        raise reader.error("has a name that is not printable, expected text", number)
    if len(entry.name.encode("utf-8")) > _MAX_NAME:
        raise reader.error(f"has a name longer than {_MAX_NAME} bytes", entry.name)
    if len(entry.shape) > _MAX_AXES:
        raise reader.error(f"has {len(entry.shape)} axes, expected at most {_MAX_AXES}", entry.name)
    # numpy refuses shapes whose non-zero axes overflow, be the array empty or not.
    if math.prod(max(size, 1) for size in entry.shape) * entry.dtype.itemsize >= 2**63:
        raise reader.error(
            f"has shape {_shape_text(entry.shape)}, expected less than 2**63 bytes", entry.name
        )


def _require_separate(entries: list[_Entry], header_end: int, reader: _Reader) -> None:
    """No field may share bytes with another, or with the header."""
    last_name, last_end = "the header", header_end
    for entry in sorted(entries, key=lambda e: (e.offset, e.end)):
        if entry.end == entry.offset:
            continue
        if entry.offset < last_end:
            raise reader.error(
                f"starts at byte {entry.offset}, inside {last_name}; expected it behind byte {last_end}",
                entry.name,
            )
        last_name, last_end = f"field '{_printable(entry.name)}'", entry.end


def _name_format(head: bytes) -> str:
    """What a file that is no tensor file seems to be."""
    for magic, name in _FOREIGN:
        if head.startswith(magic):
            return name
    text = head.replace(b"\0", b"").decode("latin-1").lower()  # without zeros UTF-16 reads like ASCII
    for words, name in _FOREIGN_WORDS:
        if any(word in text for word in words):
            return name
    if all(byte in b"\t\n\r\f" or 32 <= byte < 127 for byte in head):
        return "a text file"
    return "an unknown format"


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
    """Read an RGL file, spectral or RGB, isotropic or anisotropic, everything checked.

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
    _check(tensors, _Reader(path))
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
        UsageError: the file cannot be written.
    """
    path = Path(path)
    reader = _Reader(path, _WRITE_REMEDY)
    spectral = file.wavelengths_nm is not None
    tensors: dict[str, Array] = {
        "version": _stored("version", file.version, "<u4", reader),
        "description": _stored("description", file.description, "u1", reader),
        "phi_i": file.phi_i_rad,
        "theta_i": file.theta_i_rad,
        **({"wavelengths": file.wavelengths_nm} if file.wavelengths_nm is not None else {}),
        "sigma": file.sigma,
        "ndf": file.ndf,
        "vndf": file.vndf,
        "luminance": file.luminance,
        "spectra" if spectral else "rgb": file.spectra,
        "jacobian": _stored("jacobian", (bool(file.jacobian),), "u1", reader),
        "valid": file.valid,
    }
    for name in file.extra:
        if name in _FIELDS:
            raise reader.error("stands among the extra fields, expected another name there", name)
    tensors |= file.extra
    _check_arrays(tensors, reader)
    _check(tensors, reader)
    write_tensors(path, tensors)


_WRITE_REMEDY = "correct the record; nothing was written"


def _stored(name: str, value: str | tuple[int, ...], dtype: str, reader: _Reader) -> Array:
    """A text or numbers of a record as the array that the file holds."""
    try:
        if isinstance(value, str):
            return np.frombuffer(value.encode("utf-8", "surrogateescape"), dtype=dtype)
        return np.array(value, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise reader.error(f"cannot be stored as {np.dtype(dtype).name} ({error})", name) from None


def write_tensors(path: Path | str, fields: Mapping[str, Array]) -> None:
    """Write named arrays as a tensor file, atomically, every field aligned to 8 bytes.

    Raises:
        FileFormatError: a field that tensor files cannot hold.
        UsageError: the file cannot be written.
    """
    path = Path(path)
    if not path.name or "\0" in path.name:
        raise UsageError(
            f"{_printable(str(path), 255)}: names no file, expected the path of a tensor file; add a file name"
        )
    reader = _Reader(path, _WRITE_REMEDY)
    _check_arrays(fields, reader)
    position = _aligned(_PREAMBLE.size + sum(map(_header_size, fields, fields.values())))
    entries: list[_Entry] = []
    for name, array in fields.items():
        entries.append(_Entry(name, array.dtype, array.shape, position))
        position = _aligned(entries[-1].end)
    with atomic.replacing(path) as partial, open(partial, "wb") as out:
        out.write(_PREAMBLE.pack(MAGIC, 1, 0, len(entries)))
        for entry in entries:
            out.write(entry.header())
        for entry, array in zip(entries, fields.values(), strict=True):
            out.write(bytes(entry.offset - out.tell()))
            if array.size:
                out.write(np.ascontiguousarray(array).data)
        out.write(bytes(position - out.tell()))


def _header_size(name: str, array: Array) -> int:
    return len(_Entry(name, array.dtype, array.shape, 0).header())


def _check_arrays(fields: Mapping[str, Array], reader: _Reader) -> None:
    """Everything given is an array that a tensor file can hold, under a name that can be read back."""
    if len(fields) > _MAX_FIELDS:
        raise reader.error(f"would hold {len(fields)} fields, expected at most {_MAX_FIELDS}")
    for number, (name, array) in enumerate(fields.items(), start=1):
        if not isinstance(name, str):
            raise reader.error(f"has a name of type {type(name).__name__}, expected text", f"#{number}")
        if not isinstance(array, np.ndarray):
            raise reader.error(f"is a {type(array).__name__}, expected a NumPy array", name)
        if array.dtype not in _CODES:
            known = ", ".join(dtype.name for dtype in _CODES)
            raise reader.error(f"has dtype {array.dtype.str}, expected little-endian {known}", name)
        _check_entry(_Entry(name, array.dtype, array.shape, 0), reader, f"#{number}")


def _aligned(position: int) -> int:
    return -(-position // _ALIGNMENT) * _ALIGNMENT


def _check(tensors: Mapping[str, Array], reader: _Reader) -> None:
    """Everything that reading and writing rely on.

    Raises:
        FileFormatError: names the file and the first field that is not as expected.
    """
    _check_layout(tensors, reader)
    _check_grids(tensors, reader)
    _check_values(tensors, reader)


def _check_layout(tensors: Mapping[str, Array], reader: _Reader) -> None:
    """Presence, dtype and shape of every field."""
    spectral = "spectra" in tensors
    if spectral == ("rgb" in tensors):
        found = _printable(", ".join(tensors), 200) or "none"
        raise reader.error(
            f"found fields {found}, expected either 'spectra' or 'rgb' among them",
            remedy="it is no RGL file, or a damaged one: fetch it again",
        )
    sizes: dict[str, int] = {}
    for name, (dtype, axes) in _FIELDS.items():
        if name == ("rgb" if spectral else "spectra"):
            continue
        if name == "wavelengths" and not spectral:
            if name in tensors:
                raise reader.error("stands beside 'rgb', expected it beside 'spectra' only", name)
            continue
        if name not in tensors:
            raise reader.error("is missing, expected in every RGL file", name)
        array = tensors[name]
        if array.dtype != np.dtype(dtype):
            raise reader.error(f"has dtype {array.dtype.name}, expected {np.dtype(dtype).name}", name)
        if axes is not None:
            _check_shape(name, array.shape, axes, sizes, reader)
    cells = tensors["luminance"].size
    if tensors["valid"].size not in (cells, -(-cells // 8)):
        raise reader.error(
            f"has {tensors['valid'].size} bytes, expected one bit ({-(-cells // 8)}) or one byte ({cells}) per cell",
            "valid",
        )


def _check_shape(
    name: str, shape: tuple[int, ...], axes: tuple[str | int, ...], sizes: dict[str, int], reader: _Reader
) -> None:
    """Match a shape against axes; the first field with a letter fixes its size for the others."""
    if len(shape) != len(axes):
        words = ", ".join(_AXIS_WORDS.get(a, str(a) or "any") if isinstance(a, str) else str(a) for a in axes)
        raise reader.error(f"has shape {_shape_text(shape)}, expected {len(axes)} axes ({words})", name)
    for axis, (letter, size) in enumerate(zip(axes, shape, strict=True)):
        expected = letter if isinstance(letter, int) else sizes.setdefault(letter, size) if letter else size
        if size != expected:
            word = f" ({_AXIS_WORDS[letter]})" if isinstance(letter, str) else ""
            raise reader.error(
                f"has shape {_shape_text(shape)}, expected {expected} along axis {axis}{word}", name
            )
    required = 2 if name in _AT_LEAST_TWO else 1
    interpolated = shape[2:] if name in ("vndf", "luminance") else shape
    if name != "description" and min(interpolated) < required:
        raise reader.error(
            f"has shape {_shape_text(shape)}, expected at least {required} along every axis", name
        )


def _check_grids(tensors: Mapping[str, Array], reader: _Reader) -> None:
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
            raise _bad_value(name, values, ~np.isfinite(values), "finite values", reader)
        falls = np.flatnonzero(values[1:] <= values[:-1])
        if falls.size:
            k = int(falls[0])
            raise reader.error(
                f"goes from {values[k]:.6g} to {values[k + 1]:.6g} at index {k}, expected increasing values",
                name,
            )
        if values[0] < low or values[-1] > high:
            raise reader.error(f"runs from {values[0]:.4g} to {values[-1]:.4g}, expected {words}", name)


def _check_values(tensors: Mapping[str, Array], reader: _Reader) -> None:
    """Tables: finite, of the right sign, and densities that are not zero everywhere."""
    for name in ("sigma", "ndf", "vndf", "luminance", "spectra", "rgb"):
        if name in tensors:
            low, high = tensors[name].min(), tensors[name].max()  # NaN wins in both: no temporaries needed
            if not (np.isfinite(low) and np.isfinite(high)):
                raise _bad_value(name, tensors[name], ~np.isfinite(tensors[name]), "finite values", reader)
            if name in ("ndf", "vndf") and low < 0:
                raise _bad_value(name, tensors[name], tensors[name] < 0, "no negative densities", reader)
            if name == "sigma" and low <= 0:
                raise _bad_value(name, tensors[name], tensors[name] <= 0, "positive areas", reader)
    peaks = tensors["vndf"].max(axis=(2, 3))
    if np.any(peaks <= 0):
        phi, theta = (int(k[0]) for k in np.nonzero(peaks <= 0))
        raise reader.error(f"is zero everywhere at incidence ({phi}, {theta}), expected a density", "vndf")
    if tensors["jacobian"][0] > 1:
        raise reader.error(f"is {int(tensors['jacobian'][0])}, expected 0 or 1", "jacobian")


def _bad_value(name: str, values: Array, bad: Array, expected: str, reader: _Reader) -> FileFormatError:
    """The error of a table with bad values: the first of them, where it stands, and how many there are."""
    index = tuple(int(k) for k in np.unravel_index(int(np.argmax(bad)), bad.shape))
    count = int(np.count_nonzero(bad))
    others = f" and {count - 1} more values are bad" if count > 1 else ""
    return reader.error(f"is {values[index]:.4g} at index {index}{others}, expected {expected}", name)
