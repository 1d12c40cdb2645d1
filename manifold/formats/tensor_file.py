"""Tensor files: named arrays in one file, mapped when read, byte for byte the same when written.

    12 bytes "tensor_file\\0", u8 major = 1, u8 minor = 0, u32 number of fields; per field u16 length of the name,
    name, u16 ndim, u8 dtype, u64 offset in the file, u64 shape[ndim]; then the data. Little-endian throughout.

Source: Dupuy & Jakob 2018, the files of the RGL material database.
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

import numpy as np

from manifold.errors import FileFormatError, UsageError
from manifold.formats.foreign import name_format
from manifold.records import Array
from manifold.system import atomic

MAGIC = b"tensor_file\0"
_PREAMBLE = struct.Struct("<12sBBI")
_SMALLEST_FIELD = 14  # bytes of a field's header: empty name, no axes
_MAX_AXES = 32  # numpy's own limit was this for decades; RGL files have at most 5
_MOST_BYTES = 4 << 30
_MAX_FIELDS = 1024  # RGL files have 13; without a limit the names of a large damaged file fill the memory
_MAX_NAME = 0xFFFF  # bytes
_ALIGNMENT = 8
_SNIFFED = 8192  # bytes of another format's header that may hold the word that tells it
WRITE_REMEDY = "correct the record; nothing was written"

_DTYPES = {
    1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
_CODES = {np.dtype(name): code for code, name in _DTYPES.items()}


class ErrorContext:
    """Errors of one short line that name the file and, where there is one, the field, and say what to do."""

    def __init__(self, path: Path, remedy: str = "the file is damaged: fetch it again") -> None:
        self.path = path
        self.remedy = remedy  # what to do where an error says nothing better

    def error(self, found: str, field: str | None = None, remedy: str | None = None) -> FileFormatError:
        where = f"{printable(self.path.name or str(self.path), 255)}: "
        if field is not None:
            where += f"field '{printable(field)}' "
        return FileFormatError(f"{where}{found}; {remedy or self.remedy}")


def printable(text: str, limit: int = 64) -> str:
    """The text on one line: what does not print as an escape, the end of a long text left out."""
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: limit + 1])
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def shape_text(shape: tuple[int, ...]) -> str:
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
    context = ErrorContext(path)
    buffer = _map(path, context)
    entries, header_end = _read_header(buffer, context)
    _require_separate(entries, header_end, context)
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


def _map(path: Path, context: ErrorContext) -> mmap.mmap:
    """The whole file as read-only memory."""
    try:
        # A pipe would block in open(), a device could go on for ever: only regular files are opened.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise context.error(
                "is not a regular file, expected an RGL tensor file", remedy="name the .bsdf file itself"
            )
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size < _PREAMBLE.size:
                raise context.error(
                    f"has {size} bytes, expected an RGL tensor file",
                    remedy="it is empty or cut off: fetch it again",
                )
            if size > _MOST_BYTES:
                raise context.error(
                    f"has {size} bytes, expected at most {_MOST_BYTES}",
                    remedy="the largest files of the database have 111 MB",
                )
            return mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise context.error(
            f"cannot be read ({reason}), expected an RGL tensor file",
            remedy="check the path and its permissions",
        ) from error


def _read_header(buffer: mmap.mmap, context: ErrorContext) -> tuple[list[_Entry], int]:
    """All field headers, checked against the size of the file, and where they end."""
    size = len(buffer)
    magic, major, minor, count = _PREAMBLE.unpack_from(buffer)
    if magic != MAGIC:
        raise context.error(
            f"found {name_format(buffer[:_SNIFFED])}, expected an RGL tensor file (it begins with 'tensor_file')",
            remedy="give a file of the RGL database or its tools; `manifold convert` makes one of other formats",
        )
    if (major, minor) != (1, 0):
        raise context.error(
            f"has tensor format {major}.{minor}, expected 1.0",
            remedy="convert it with the tool that wrote it",
        )
    if count * _SMALLEST_FIELD > size - _PREAMBLE.size:
        raise context.error(f"announces {count} fields, more than its {size} bytes can hold")
    if count > _MAX_FIELDS:
        raise context.error(f"announces {count} fields, expected at most {_MAX_FIELDS}")
    entries: list[_Entry] = []
    names: set[str] = set()
    position = _PREAMBLE.size
    for index in range(count):
        entry, position = _read_entry(buffer, position, index, context)
        if entry.name in names:
            raise context.error("appears twice, expected unique names", entry.name)
        names.add(entry.name)
        entries.append(entry)
    return entries, position


def _read_entry(buffer: mmap.mmap, position: int, index: int, context: ErrorContext) -> tuple[_Entry, int]:
    """One field header and the position behind it."""
    size = len(buffer)
    shown = f"#{index + 1}"

    def take(format_: str) -> tuple[int, ...]:
        nonlocal position
        width = struct.calcsize(format_)
        if position + width > size:
            raise context.error("has a header cut off by the end of the file, expected all of it", shown)
        values = struct.unpack_from(format_, buffer, position)
        position += width
        return values

    (length,) = take("<H")
    if position + length > size:
        raise context.error(f"has a name of {length} bytes, more than the file holds", shown)
    try:
        name = buffer[position : position + length].decode("utf-8")
    except UnicodeDecodeError:
        raise context.error("has a name that is not UTF-8, expected text", shown) from None
    shown = name
    position += length
    ndim, code, offset = take("<HBQ")
    if ndim > _MAX_AXES:
        raise context.error(f"has {ndim} axes, expected at most {_MAX_AXES}", shown)
    if code not in _DTYPES:
        raise context.error(f"has dtype {code}, expected 1 to 11", shown)
    entry = _Entry(name, np.dtype(_DTYPES[code]), take(f"<{ndim}Q"), offset)
    _check_entry(entry, context, f"#{index + 1}")
    if entry.end > size:
        raise context.error(
            f"with shape {shape_text(entry.shape)} and dtype {entry.dtype.name} ends at byte {entry.end}, "
            f"but the file has {size}",
            shown,
            remedy="it is truncated or damaged: fetch it again",
        )
    return entry, position


def _check_entry(entry: _Entry, context: ErrorContext, number: str) -> None:
    """What every field must satisfy to be written and read back: a name to print, a shape numpy can hold."""
    if not entry.name.isprintable():
        raise context.error("has a name that is not printable, expected text", number)
    if len(entry.name.encode("utf-8")) > _MAX_NAME:
        raise context.error(f"has a name longer than {_MAX_NAME} bytes", entry.name)
    if len(entry.shape) > _MAX_AXES:
        raise context.error(f"has {len(entry.shape)} axes, expected at most {_MAX_AXES}", entry.name)
    # numpy refuses shapes whose non-zero axes overflow, be the array empty or not.
    if math.prod(max(size, 1) for size in entry.shape) * entry.dtype.itemsize >= 2**63:
        raise context.error(
            f"has shape {shape_text(entry.shape)}, expected less than 2**63 bytes", entry.name
        )


def _require_separate(entries: list[_Entry], header_end: int, context: ErrorContext) -> None:
    """No field may share bytes with another, or with the header."""
    last_name, last_end = "the header", header_end
    for entry in sorted(entries, key=lambda e: (e.offset, e.end)):
        if entry.end == entry.offset:
            continue
        if entry.offset < last_end:
            raise context.error(
                f"starts at byte {entry.offset}, inside {last_name}; expected it behind byte {last_end}",
                entry.name,
            )
        last_name, last_end = f"field '{printable(entry.name)}'", entry.end


def write_tensors(path: Path | str, fields: Mapping[str, Array]) -> None:
    """Write named arrays as a tensor file, atomically, every field aligned to 8 bytes.

    Raises:
        FileFormatError: a field that tensor files cannot hold.
        UsageError: the file cannot be written.
    """
    path = Path(path)
    if not path.name or "\0" in path.name:
        raise UsageError(
            f"{printable(str(path), 255)}: names no file, expected the path of a tensor file; add a file name"
        )
    context = ErrorContext(path, WRITE_REMEDY)
    check_tensors(fields, context)
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


def check_tensors(fields: Mapping[str, Array], context: ErrorContext) -> None:
    """Everything given is an array that a tensor file can hold, under a name that can be read back."""
    if len(fields) > _MAX_FIELDS:
        raise context.error(f"would hold {len(fields)} fields, expected at most {_MAX_FIELDS}")
    for number, (name, array) in enumerate(fields.items(), start=1):
        if not isinstance(name, str):
            raise context.error(f"has a name of type {type(name).__name__}, expected text", f"#{number}")
        if not isinstance(array, np.ndarray):
            raise context.error(f"is a {type(array).__name__}, expected a NumPy array", name)
        if array.dtype not in _CODES:
            known = ", ".join(dtype.name for dtype in _CODES)
            raise context.error(f"has dtype {array.dtype.str}, expected little-endian {known}", name)
        _check_entry(_Entry(name, array.dtype, array.shape, 0), context, f"#{number}")


def _aligned(position: int) -> int:
    return -(-position // _ALIGNMENT) * _ALIGNMENT
