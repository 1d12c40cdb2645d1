r"""Reads and writes tensor files, which hold named arrays.

    12 bytes "tensor_file\0", u8 major = 1, u8 minor = 0, u32 number of fields; per field u16 length of the name,
    name, u16 ndim, u8 dtype, u64 offset in the file, u64 shape[ndim]; then the data. Little-endian throughout.

Source: Dupuy & Jakob 2018, the files of the RGL material database.
"""

from __future__ import annotations

import math
import mmap
import os
import struct
import zlib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifold.core import disk
from manifold.core.records import AnyArray
from manifold.formats.foreign import name_format
from manifold.formats.text import ErrorContext

MAGIC, GZIP = b"tensor_file\0", b"\x1f\x8b"
_PREAMBLE = struct.Struct("<12sBBI")
_FIELD = struct.Struct("<HBQ")  # number of axes, dtype, offset
_MOST_FIELDS = 1024  # RGL files have 13
_ALIGNMENT = 8
_MOST_PADDING = 4096  # bytes that no field uses, per field: a page, more than any alignment needs
_MOST_HEADER = 1 << 20  # bytes; 13 fields have 412
_SNIFFED = 8192  # bytes of another format's header that may hold the word that tells it
_GZIP_STREAM = 31  # of zlib: a header and a trailer of gzip
_MOST_UNPACKED = 2 << 30  # bytes; the largest files of the database have a fifth

_DTYPES = {
    1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
_CODES = {np.dtype(name): code for code, name in _DTYPES.items()}


def shape_text(shape: tuple[int, ...]) -> str:
    """Return a shape as numpy writes it, cut off if a damaged header makes it long."""
    return str(shape) if len(shape) <= 8 else f"({', '.join(map(str, shape[:4]))}, ... {len(shape)} axes)"


def holds_tensors(head: bytes) -> bool:
    """Return whether a file that begins with these bytes is a tensor file, compressed by gzip or not."""
    if head.startswith(GZIP):
        try:
            head = zlib.decompressobj(_GZIP_STREAM).decompress(head, len(MAGIC))
        except zlib.error:
            return False
    return head.startswith(MAGIC)


def is_tensor_file(path: Path) -> bool:
    """Return whether a path is a tensor file, compressed by gzip or not."""
    if not os.path.isfile(path) or not os.access(path, os.R_OK):
        return False
    with path.open("rb") as stream:
        return holds_tensors(stream.read(_SNIFFED))


def is_compressed(path: Path) -> bool:
    """Return whether a path is a tensor file that is compressed by gzip."""
    return disk.begins_with(path, GZIP) and is_tensor_file(path)


def read_tensors(path: Path | str, content: bytes | None = None) -> dict[str, AnyArray]:
    """Return the fields of any tensor file, in the order of the file, as read-only views of it, mapped or decompressed.

    If the bytes of the file are given as `content`, `path` is only used as its name in errors.

    A mapped file must not be shortened while the arrays live: the operating system ends a process that reads beyond
    its end. Replacing it by renaming, as `write_tensors` does, is safe.
    """
    path = Path(path)
    context = ErrorContext(path, "the file is damaged: fetch it again")
    buffer: mmap.mmap | bytes = _map(path, context) if content is None else content
    if not buffer:
        raise context.error("is empty, expected an RGL tensor file")
    if buffer[:2] == GZIP and holds_tensors(buffer[:_SNIFFED]):
        buffer = _decompress(buffer, context)
    return {field.name: _view(buffer, field, context) for field in _read_header(buffer, len(buffer), context)}


class _Field(NamedTuple):
    """A field as the header announces it: its bytes begin at `offset`."""

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    offset: int

    @property
    def end(self) -> int:
        return self.offset + math.prod(self.shape) * self.dtype.itemsize


def _read_header(buffer: mmap.mmap | bytes, size: int, context: ErrorContext) -> list[_Field]:
    """Return the fields of a file of `size` bytes, which begins with `buffer`, after checking where they lie."""
    if len(buffer) < _PREAMBLE.size:
        raise context.error(f"has {len(buffer)} bytes, expected an RGL tensor file")
    magic, major, minor, count = _PREAMBLE.unpack_from(buffer)
    if magic != MAGIC:
        raise context.error(
            f"found {name_format(buffer[:_SNIFFED])}, expected an RGL tensor file (it begins with 'tensor_file')",
            remedy="give a file of the RGL database or its tools; `manifold convert` makes one of other formats",
        )
    if (major, minor) != (1, 0):
        raise context.error(f"has tensor format {major}.{minor}, expected 1.0")
    if count > _MOST_FIELDS:
        raise context.error(f"announces {count} fields, expected at most {_MOST_FIELDS}")
    fields: dict[str, _Field] = {}
    position = _PREAMBLE.size
    for index in range(count):
        field, position = _read_field(buffer, position, f"#{index + 1}", context)
        if field.end > size:
            raise context.error(
                f"with shape {shape_text(field.shape)} and dtype {field.dtype.name} ends beyond the file of {size} "
                "bytes",
                field=field.name,
            )
        if field.name in fields:
            raise context.error("appears twice, expected unique names", field=field.name)
        fields[field.name] = field
    spans = sorted((field.offset, field.end, field.name) for field in fields.values() if 0 not in field.shape)
    for (_, end, before), (start, _, name) in pairwise([(0, position, "header"), *spans]):
        if start < end:
            raise context.error(f"starts at byte {start}, inside '{before[:64]}'", field=name)
    unused = size - position - sum(end - start for start, end, _ in spans)
    if unused > _MOST_PADDING * (count + 1):
        raise context.error(
            f"has {unused} bytes that belong to no field, expected only padding between fields"
        )
    return list(fields.values())


def _map(path: Path, context: ErrorContext) -> mmap.mmap | bytes:
    """Map the whole file as read-only memory; an empty one cannot be mapped."""
    advice = "expected an RGL tensor file; check the path"
    disk.require_regular(path, advice)
    try:
        with path.open("rb") as file:
            if not os.fstat(file.fileno()).st_size:
                return b""
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise disk.cannot_read(path, error, advice) from error


def _decompress(packed: mmap.mmap | bytes, context: ErrorContext) -> bytes:
    """Decompress a file, which ends with its size: no more memory is taken than its fields need."""
    size = int.from_bytes(packed[-4:], "little")
    if size > _MOST_UNPACKED:
        raise context.error(f"holds {size} bytes, expected at most {_MOST_UNPACKED}")
    head, stream = zlib.decompressobj(_GZIP_STREAM), zlib.decompressobj(_GZIP_STREAM)
    try:
        _read_header(head.decompress(packed[:_MOST_HEADER], min(size, _MOST_HEADER) or 1), size, context)
        content = stream.decompress(packed, size + 1)
    except zlib.error as error:
        raise context.error(f"cannot be decompressed ({error})") from error
    if len(content) != size or not stream.eof or stream.unused_data:
        raise context.error(f"does not decompress to the {size} bytes that it announces")
    return content


def _read_field(
    buffer: mmap.mmap | bytes, position: int, number: str, context: ErrorContext
) -> tuple[_Field, int]:
    """Return a field, and the position behind its header; `number` stands for its name in errors."""
    try:
        (length,) = struct.unpack_from("<H", buffer, position)
        end = position + 2 + length
        name = buffer[position + 2 : end].decode("utf-8")
        ndim, code, offset = _FIELD.unpack_from(buffer, end)
        shape = struct.unpack_from(f"<{ndim}Q", buffer, end + _FIELD.size)
    except UnicodeDecodeError:
        raise context.error("has a name that is not UTF-8, expected text", field=number) from None
    except struct.error:
        raise context.error("has a header cut off by the end of the file", field=number) from None
    if not name.isprintable():
        raise context.error("has a name that does not print, expected text", field=number)
    if code not in _DTYPES:
        raise context.error(f"has dtype {code}, expected 1 to 11", field=name)
    return _Field(name, np.dtype(_DTYPES[code]), shape, offset), end + _FIELD.size + 8 * ndim


def _view(buffer: mmap.mmap | bytes, field: _Field, context: ErrorContext) -> AnyArray:
    """Return the data of a field, without a copy unless the file does not align it."""
    count = math.prod(field.shape)
    # Behind the end of a file there is nothing to view.
    array = np.frombuffer(buffer, field.dtype, count, field.offset) if count else np.empty(0, field.dtype)
    try:
        array = np.require(array, requirements="A").reshape(field.shape)
    except (ValueError, OverflowError):  # axes whose product overflows, one of them 0; or too many
        raise context.error(
            f"has shape {shape_text(field.shape)}, which is too large", field=field.name
        ) from None
    array.flags.writeable = False
    return array


def write_tensors(path: Path | str, fields: Mapping[str, AnyArray]) -> None:
    """Write named arrays as a tensor file, atomically, every field aligned to 8 bytes."""
    path = Path(path)
    context = ErrorContext(path, "correct the record; nothing was written")
    for name, array in fields.items():
        if array.dtype not in _CODES:
            known = ", ".join(dtype.name for dtype in _CODES)
            raise context.error(f"has dtype {array.dtype.str}, expected little-endian {known}", field=name)
    offset = _aligned(_PREAMBLE.size + sum(len(_header(name, array, 0)) for name, array in fields.items()))
    with disk.replacing(path) as partial, open(partial, "wb") as out:
        out.write(_PREAMBLE.pack(MAGIC, 1, 0, len(fields)))
        for name, array in fields.items():
            out.write(_header(name, array, offset))
            offset = _aligned(offset + array.nbytes)
        for array in fields.values():
            out.write(bytes(_aligned(out.tell()) - out.tell()))
            if array.size:
                out.write(np.ascontiguousarray(array).data)
        out.write(bytes(_aligned(out.tell()) - out.tell()))


def _header(name: str, array: AnyArray, offset: int) -> bytes:
    """Return the header of a field whose data start at an offset."""
    text, axes = name.encode("utf-8"), struct.pack(f"<{array.ndim}Q", *array.shape)
    return struct.pack("<H", len(text)) + text + _FIELD.pack(array.ndim, _CODES[array.dtype], offset) + axes


def _aligned(position: int) -> int:
    return -(-position // _ALIGNMENT) * _ALIGNMENT
