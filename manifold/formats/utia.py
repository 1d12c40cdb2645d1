"""UTIA files, `.bin`: anisotropic BRDFs in linear sRGB at 6 x 48 incident and 6 x 48 outgoing directions.

A file has float64 values without a header, with index `plane * 288^2 + 288 (48 ti + pi) + 48 tv + pv`; polar angles are
0, 15, ... 75 degrees, azimuths multiples of 7.5 degrees.

Source: Filip & Vavra 2014, "Template-based sampling of anisotropic BRDFs".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from manifold.core import disk
from manifold.core.records import Array
from manifold.formats.dense import DenseTable
from manifold.formats.text import ErrorContext, read_bytes

SHAPE = (6, 48, 6, 48)
SIZE = 8 * 3 * 288 * 288
_LARGEST_ALBEDO = 1.1  # coarse nodes may bring a highlight's above 1
_LARGEST_VALUE = 1e6  # largest f in 1/sr; bytes of other files are numbers of any size


def axes() -> tuple[Array, Array, Array, Array]:
    """Return theta_i (6,), phi_i (48,), theta_o (6,), phi_o (48,) in radians."""
    theta, phi = np.deg2rad(15.0 * np.arange(6)), np.deg2rad(7.5 * np.arange(48))
    return theta, phi, theta, phi


def sniff(head: bytes) -> bool:
    """Return whether the first values look like a BRDF. The length of the file decides when it is read."""
    count = len(head) // 8
    if count < 288:
        return False
    values = np.frombuffer(head, "<f8", count)
    with np.errstate(invalid="ignore"):
        plausible = (
            np.isfinite(values)
            & (np.abs(values) < _LARGEST_VALUE)
            & ((values == 0) | (np.abs(values) > 1e-12))
        )
    return bool(plausible.mean() > 0.99 and np.any(values > 0) and np.mean(values >= 0) > 0.5)


def read(path: Path) -> list[DenseTable]:
    """Read the table, in linear sRGB."""
    context = ErrorContext(path, "download the file again")
    data = read_bytes(path, 2 * SIZE)
    if len(data) != SIZE:
        raise context.error(
            f"has {len(data)} bytes, expected {SIZE} of a UTIA file: it is cut off or another file"
        )
    planes = np.frombuffer(data, "<f8").reshape(3, *SHAPE)
    bad = ~np.isfinite(planes) | (np.abs(planes) > 1e12)
    if np.any(bad):
        plane, *node = (int(k[0]) for k in np.nonzero(bad))
        raise context.error(
            f"{'RGB'[plane]} at node {tuple(node)} is {planes[(plane, *node)]:.3g}, expected f in 1/sr"
        )
    values = np.ascontiguousarray(np.moveaxis(planes, 0, -1))
    notes = ["values are taken as f in 1/sr, linear sRGB"]
    albedo = _largest_albedo(values)
    if albedo > _LARGEST_ALBEDO:
        notes.append(
            f"not energy-conserving: directional albedo {albedo:.3g}; the database names no unit, and the values may "
            "be reflectance factors, or encoded as sRGB"
        )
    return [DenseTable(path.stem, "UTIA", "incident-outgoing", axes(), None, values, tuple(notes))]


def _largest_albedo(values: Array) -> float:
    """Return the largest directional albedo of f (theta_i, phi_i, theta_o, phi_o, 3)."""
    edges = np.append(np.maximum(axes()[2] - np.deg2rad(7.5), 0.0), 0.5 * np.pi)
    rings = np.pi * np.diff(np.sin(edges) ** 2)  # projected solid angle around every polar angle
    return float(np.max(np.einsum("o,aboc->abc", rings, values.mean(axis=3))))


def write(path: Path, table: DenseTable) -> None:
    """Write a table in linear sRGB at UTIA's nodes as a UTIA file."""
    planes = np.nan_to_num(np.moveaxis(table.values, -1, 0))
    disk.write_bytes(path, planes.astype("<f8").tobytes())
