"""Stores the field `vndf` as its difference from values computed from `ndf`, and restores it bit for bit.

A table of visible normals follows from the normal distribution: `D(m) max(0, wi . m) sqrt(theta) sin(theta)`, up to a
factor per incident direction. In most files the stored and the computed table differ only by rounding; their
difference, in units in the last place, is mostly zeros and compresses to a few per cent. Larger differences are
stored in the same way.

Source: Dupuy & Jakob 2018, section 4.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manifold.core.directions import HORIZON, u_to_phi, u_to_theta
from manifold.core.records import AnyArray, Array, BsdfFile

Differences = NDArray[np.int32]


class Slices(NamedTuple):
    """The parameters that, with `ndf`, determine the tables of visible normals of P x T incident directions.

    Attributes:
        elevations_rad: polar angles of the incident directions in radians, shape (P, T), limited at the horizon.
        factors: factor of each table, shape (P, T).
    """

    elevations_rad: Array
    factors: Array

    def to_json(self) -> dict[str, Any]:
        """Return the parameters as lists that JSON can hold."""
        return {name: values.tolist() for name, values in self._asdict().items()}

    @classmethod
    def from_json(cls, content: Any) -> Slices:
        """Restore the parameters from `to_json`. Raises LookupError or ValueError for other values."""
        return cls(*(np.array(content[name], dtype=np.float64) for name in cls._fields))


def encode(file: BsdfFile) -> tuple[Differences, Slices]:
    """Return the differences of `vndf` from computed tables, in units in the last place, and their parameters."""
    shape = file.vndf.shape[:2]
    differences = np.empty(file.vndf.shape, np.int32)
    slices = Slices(np.empty(shape), np.empty(shape))
    azimuths = _azimuths(file.phi_i_rad)
    for p, t in np.ndindex(shape):
        table, found = file.vndf[p, t], []
        for elevation in {float(file.theta_i_rad[t]), min(float(file.theta_i_rad[t]), HORIZON)}:
            expected = _visible(file.ndf, table.shape, elevation, float(azimuths[p]))
            squared = float(np.sum(expected * expected))
            factor = float(np.sum(table * expected)) / squared if squared > 0.0 else 0.0
            difference = table.view(np.int32) - _rounded(factor * expected).view(np.int32)
            found.append((np.count_nonzero(difference), elevation, factor, difference))
        _, slices.elevations_rad[p, t], slices.factors[p, t], differences[p, t] = min(
            found, key=lambda each: each[:2]
        )
    return differences, slices


def decode(differences: Differences, slices: Slices, ndf: Array, phi_i_rad: Array) -> Array:
    """Decode `vndf`, float32; the result is identical bit for bit on every machine."""
    vndf = np.empty(differences.shape, np.float32)
    azimuths = _azimuths(phi_i_rad)
    for p, t in np.ndindex(differences.shape[:2]):
        elevation, azimuth = float(slices.elevations_rad[p, t]), float(azimuths[p])
        expected = _visible(ndf, differences.shape[2:], elevation, azimuth)
        rounded = _rounded(slices.factors[p, t] * expected)
        vndf[p, t] = (rounded.view(np.int32) + differences[p, t]).view(np.float32)
    return vndf


def _azimuths(phi_i_rad: Array) -> Array:
    """Return the azimuths of the incident directions; isotropic files count the normals' azimuths from them."""
    return phi_i_rad.astype(np.float64) if len(phi_i_rad) > 2 else np.zeros(len(phi_i_rad))


def _visible(ndf: Array, shape: tuple[int, ...], theta_i: float, phi_i: float) -> Array:
    """Return `D(m) max(0, wi . m) u sin(theta)` on a grid (R, C), u that of theta; 0 if `ndf` has another grid."""
    rows, columns = shape
    if ndf.shape[1] != columns:
        return np.zeros(shape)
    u = np.linspace(0.0, 1.0, columns)
    theta = u_to_theta(u)
    sine, cosine = _sine(theta), _sine(0.5 * np.pi - theta)
    half_turn = _sine(0.5 * (u_to_phi(np.linspace(0.0, 1.0, rows)) - phi_i))
    cos_im = cosine * _sine(np.array(0.5 * np.pi - theta_i)) + (
        (1.0 - 2.0 * half_turn * half_turn)[:, None] * (sine * _sine(np.array(theta_i)))
    )
    table = ndf if len(ndf) == rows else ndf[:1]  # rows of isotropic files are alike
    return np.asarray(table * np.maximum(cos_im, 0.0) * (u * sine))


def _sine(x: AnyArray) -> Array:
    """Return the sine of angles within a turn by its series.

    NumPy's differs between machines in the last bit.
    """
    square, total = x * x, np.ones_like(x)
    for k in range(40, 0, -2):
        total = 1.0 - square / (k * (k + 1.0)) * total
    return x * total


def _rounded(values: Array) -> NDArray[np.float32]:
    with np.errstate(over="ignore", under="ignore"):
        return values.astype(np.float32)
