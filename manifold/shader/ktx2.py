"""Writes KTX 2.0 files with one uncompressed texture of half floats.

Source: Khronos, KTX File Format Specification 2.0; Khronos Data Format Specification 1.3.
"""

from __future__ import annotations

import struct

from manifold import __version__
from manifold.shader.table import CHANNELS, Halves

_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
_RGBA16F = 97  # VK_FORMAT_R16G16B16A16_SFLOAT
_HEADER = struct.Struct("<9I 4I 2Q 3Q")  # header, index, and the index of one level
_ALIGNMENT = 8  # of the level: bytes of a texel


def content(texels: Halves) -> bytes:
    """Return the bytes of a file for texels of shape (height, width, 4), with the first row at the top."""
    height, width, _ = texels.shape
    start = len(_MAGIC) + _HEADER.size
    description, values = _description(), _values()
    first = start + len(description) + len(values)
    padding = -first % _ALIGNMENT
    data = texels.astype("<f2").tobytes()
    header = _HEADER.pack(
        _RGBA16F, 2, width, height, 0, 0, 1, 1, 0,
        start, len(description), start + len(description), len(values), 0, 0,
        first + padding, len(data), len(data),
    )  # fmt: skip
    return _MAGIC + header + description + values + bytes(padding) + data


def _description() -> bytes:
    """Return the data format descriptor: linear RGBA of signed floats, primaries of BT.709."""
    samples = b"".join(
        struct.pack("<HBB4Bff", 16 * k, 15, channel | 0xC0, 0, 0, 0, 0, -1.0, 1.0)
        for k, channel in enumerate((0, 1, 2, 15))
    )
    size = 24 + 16 * CHANNELS
    block = struct.pack("<IHH4B4B8B", 0, 2, size, 1, 1, 1, 0, 0, 0, 0, 0, 2 * CHANNELS, *(0,) * 7) + samples
    return struct.pack("<I", 4 + len(block)) + block


def _values() -> bytes:
    """Return the key/value data, sorted by key."""
    parts = []
    for key, value in (("KTXorientation", "rd"), ("KTXwriter", f"manifold {__version__}")):
        entry = key.encode() + b"\0" + value.encode() + b"\0"
        parts.append(struct.pack("<I", len(entry)) + entry + bytes(-len(entry) % 4))
    return b"".join(parts)
