"""MERL files, `.binary`: 90 x 90 x 180 values of R, G and B over half and difference angles.

A file has int32 90, 90, 180, then planes of R, G, B in float64. theta_h = (i / 90)^2 * 90 degrees; theta_d and phi_d
are evenly spaced. Values times 1 / 1500, 1.15 / 1500 and 1.66 / 1500 are f in 1/sr; negative values mark unmeasured
nodes.

Source: Matusik et al. 2003, BRDFRead.cpp.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from manifold.core import disk
from manifold.core.records import Array
from manifold.formats.dense import DenseTable
from manifold.formats.text import ErrorContext, read_bytes

SHAPE = (90, 90, 180)
SCALES = np.array([1.0, 1.15, 1.66]) / 1500.0
_HEADER = struct.Struct("<3i")
_SIZE = _HEADER.size + 3 * 8 * SHAPE[0] * SHAPE[1] * SHAPE[2]


def axes() -> tuple[Array, Array, Array]:
    """Return theta_h (90,), theta_d (90,) and phi_d (180,) of the nodes in radians."""
    t = np.arange(90.0) / 90.0
    return 0.5 * np.pi * t**2, 0.5 * np.pi * t, np.pi * np.arange(180.0) / 180.0


def sniff(head: bytes) -> bool:
    """Return whether a file begins with the three counts of MERL files."""
    if len(head) < _HEADER.size:
        return False
    counts = _HEADER.unpack_from(head)
    return counts[:2] == SHAPE[:2] or counts == (180, 90, 90)


def read(path: Path) -> list[DenseTable]:
    """Read the table, in linear sRGB."""
    context = ErrorContext(path, "download the file again")
    data = read_bytes(path, 2 * _SIZE)
    counts = _HEADER.unpack_from(data)
    if counts != SHAPE:
        raise context.error(f"has {' x '.join(map(str, counts))} nodes, expected 90 x 90 x 180")
    if len(data) != _SIZE:
        raise context.error(
            f"has {len(data)} bytes, expected {_SIZE} of a MERL file: it is cut off or longer"
        )
    planes = np.frombuffer(data, "<f8", offset=_HEADER.size).reshape(3, *SHAPE)
    if not np.all(np.isfinite(planes)):
        plane, *node = (int(k[0]) for k in np.nonzero(~np.isfinite(planes)))
        raise context.error(f"{'RGB'[plane]} at node {tuple(node)} is not finite, expected a number")
    values = np.moveaxis(planes, 0, -1) * SCALES
    values[np.any(planes < 0.0, axis=0)] = np.nan
    if not np.any(np.isfinite(values)):
        raise context.error("no value was measured: all are negative")
    return [DenseTable(path.stem, "MERL", "half-difference", axes(), None, values)]


def write(path: Path, table: DenseTable) -> None:
    """Write a half-difference table in linear sRGB at MERL's nodes as a MERL file."""
    measured = np.isfinite(table.values).all(axis=-1, keepdims=True)
    # What is measured is not negative in a MERL file, where that says "not measured"; colours may be out of gamut.
    planes = np.where(measured, np.maximum(table.values, 0.0) / SCALES, -1.0)
    disk.write_bytes(path, _HEADER.pack(*SHAPE) + np.moveaxis(planes, -1, 0).astype("<f8").tobytes())
