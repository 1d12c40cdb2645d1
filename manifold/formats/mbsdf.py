"""MBSDF files of NVIDIA's Material Definition Language, `.mbsdf`: isotropic tables over polar angles and an azimuth.

A file has a line `NVIDIA ARC MBSDF V1`, lines `name="value"` of metadata, a line `MBSDF_DATA_REFLECTION=` or
`MBSDF_DATA=`, then uint32 kind (0 one band, 1 linear RGB), count of polar angles n and of azimuths m, and n x n x m
values of f in 1/sr in float32, polar angle in first and azimuth fastest, all little-endian. A block
`MBSDF_DATA_TRANSMISSION=` may follow. Elevations range from 0 to 90 degrees, azimuths between both directions from 0
to 180. Values lie at the centres of equal cells, as in textures, which agrees with the SDK's CUDA code and its
sampling.

Source: MDL specification, appendix on MBSDF; NVIDIA/MDL-SDK, i_bsdf_measurement.cpp and ibsdf_isotropic_data.h.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from manifold import __version__
from manifold.core import disk
from manifold.core.records import Array
from manifold.formats.dense import DenseTable
from manifold.formats.text import ErrorContext, read_bytes
from manifold.formats.values import UNNAMED_NM

SHAPE = (45, 45, 90)
"""Numbers of polar angles of both directions and of azimuths in written tables, in steps of two degrees."""

_MAGIC = b"NVIDIA ARC MBSDF V1\n"
_REFLECTION, _EITHER, _TRANSMISSION = (
    b"MBSDF_DATA_REFLECTION=\n",
    b"MBSDF_DATA=\n",
    b"MBSDF_DATA_TRANSMISSION=\n",
)
_COUNTS = struct.Struct("<3I")  # kind, polar angles, azimuths
_CHANNELS = {0: 1, 1: 3}
_MOST_METADATA = 1 << 16  # bytes
_MOST = 1 << 28  # bytes of a file


def axes(shape: tuple[int, int, int] | None = None) -> tuple[Array, Array, Array, Array]:
    """Return theta_i (N,), phi_i (1,), theta_o (N,) and phi_o (2 M,) of the nodes and mirrored nodes in radians.

    N and M are the first and the last of `shape`, by default of `SHAPE`.
    """
    elevations, _, azimuths = shape or SHAPE
    theta = 0.5 * np.pi * (np.arange(elevations) + 0.5) / elevations
    phi = np.pi * (np.arange(2 * azimuths) + 0.5) / azimuths
    return theta, np.zeros(1), theta, phi


def sniff(head: bytes) -> bool:
    """Return whether a file begins with the line of MBSDF files."""
    return head.startswith(_MAGIC)


def read(path: Path) -> list[DenseTable]:
    """Read the reflection; a single band is taken as 550 nm."""
    context = ErrorContext(path, "export the file again")
    data = read_bytes(path, _MOST)
    starts = {
        mark: data.find(b"\n" + mark, 0, _MOST_METADATA) + 1 for mark in (_REFLECTION, _EITHER, _TRANSMISSION)
    }
    begun = {mark: start for mark, start in starts.items() if start}
    if not begun:
        raise context.error("has no line MBSDF_DATA_REFLECTION=, expected one before the values")
    mark = min(begun, key=begun.__getitem__)
    if mark == _TRANSMISSION:
        raise context.error("holds transmission alone, expected reflection", remedy="export the reflection")
    at = begun[mark] + len(mark)
    if len(data) < at + _COUNTS.size:
        raise context.error(f"ends after {len(data)} bytes, before its counts")
    kind, elevations, azimuths = _COUNTS.unpack_from(data, at)
    if kind not in _CHANNELS or not elevations or not azimuths:
        raise context.error(
            f"has kind {kind} and {elevations} x {azimuths} angles, expected kind 0 or 1 and counts above 0"
        )
    shape = (elevations, elevations, azimuths, _CHANNELS[kind])
    size = 4 * elevations**2 * azimuths * _CHANNELS[kind]
    rest = len(data) - at - _COUNTS.size - size
    if rest < 0:
        raise context.error(f"lacks {-rest} of {size} bytes of values: it is cut off")
    values = np.frombuffer(data, "<f4", size // 4, at + _COUNTS.size).reshape(shape)
    if not np.all(np.isfinite(values)):
        node = tuple(int(k[0]) for k in np.nonzero(~np.isfinite(values)))
        raise context.error(f"the value at {node} is not finite, expected f in 1/sr")
    whole = np.concatenate([values, values[:, :, ::-1]], axis=2)[:, None].astype(float)
    notes = ("the transmission is left out",) if data[len(data) - rest :].startswith(_TRANSMISSION) else ()
    wavelengths = None if kind == 1 else np.array([UNNAMED_NM])
    return [DenseTable(path.stem, "MBSDF", "incident-outgoing", axes(shape[:3]), wavelengths, whole, notes)]


def write(path: Path, table: DenseTable) -> None:
    """Write an isotropic table in linear sRGB at the nodes of `axes` as an MBSDF file; azimuths up to 180 degrees."""
    values = np.maximum(np.nan_to_num(table.values[:, 0, :, : SHAPE[2]]), 0.0)
    about = f'generator="manifold {__version__}"\ncolorspace="linear Rec. 709"\n'.encode()
    head = _MAGIC + about + _REFLECTION + _COUNTS.pack(1, SHAPE[0], SHAPE[2])
    disk.write_bytes(path, head + values.astype("<f4").tobytes())
