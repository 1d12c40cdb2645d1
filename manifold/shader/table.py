"""Tabulates a BRDF for shaders in one table of half floats, similar to RGL files but without searches.

RGL files store values at coordinates (u, v), to which a warp maps the half vector's square coordinates (x, y); there
is one warp per angle of incidence. u is the cumulative sum within a row divided by the row's total, v the cumulative
sum of the rows. Here these sums are tabulated on a coarse grid of (x, y), so that one filtered read per incidence
returns the sum in the row, the total and the sum of rows, and another read the values.

Source: Dupuy & Jakob 2018, sections 4 and 5; f cos(theta_o) = values * ndf / (4 sigma).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.warp import cumulative_sums
from manifold.brdf.wrapper import WrappedBRDF
from manifold.colour.conversion import interpolation_matrix
from manifold.core.pairs import Pairs, flat_samples
from manifold.core.records import Array, Bands, BsdfFile
from manifold.shader.lobes import Lobes

Halves = NDArray[np.float16]

CHANNELS = 4
TEXEL_BYTES = 2 * CHANNELS
_LARGEST = 2.0**14
"""Largest value and largest normal distribution after scaling: the finite range of halves ends at 2^16."""
_MOST_NODES = (
    1024  # of the normal distribution; a few files have finer ones, which a row of texels need not hold
)
_LEAST_TOTAL = 1e-7  # of a row of a warp: less is black in halves


@dataclass(frozen=True, order=True)
class Shape:
    """The numbers of nodes of a table; shapes are ordered by their size in bytes.

    Attributes:
        bytes: size of the texture in bytes.
        incidences: number of angles of incidence, T.
        values: nodes per axis of the values, R.
        columns, rows: nodes of the sums over x (polar angle) and y (azimuth) of the half vector.
        nodes: nodes of the normal distribution, N.
    """

    bytes: int
    incidences: int
    values: int
    columns: int
    rows: int
    nodes: int

    @classmethod
    def of(cls, incidences: int, values: int, columns: int, rows: int, nodes: int) -> Shape:
        """Return the shape with these numbers of nodes, and compute the size of its texture in bytes."""
        made = cls(0, incidences, values, columns, rows, nodes)
        return replace(made, bytes=made.width * made.height * TEXEL_BYTES)

    @property
    def width(self) -> int:
        """Number of texels in a row."""
        return max(self.nodes, self.columns, self.values)

    def _rows_of(self, columns: int, rows: int) -> int:
        return -(-self.incidences // (self.width // columns)) * rows

    @property
    def first_value_row(self) -> int:
        """The row where values begin, below the sums."""
        return self._rows_of(self.columns, self.rows)

    @property
    def normal_row(self) -> int:
        """The row of the normal distribution and the projected area, the last one."""
        return self.first_value_row + self._rows_of(self.values, self.values)

    @property
    def height(self) -> int:
        """Number of rows of texels."""
        return self.normal_row + 1

    def block(self, t: int, columns: int, rows: int, first_row: int) -> tuple[slice, slice]:
        """Return the rows and columns of the texels of incidence t.

        Blocks are arranged side by side, then below each other.
        """
        row, column = divmod(t, self.width // columns)
        y, x = first_row + row * rows, column * columns
        return slice(y, y + rows), slice(x, x + columns)

    def blocks(self, t: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Return the texels of the sums and of the values of incidence t."""
        return (
            self.block(t, self.columns, self.rows, 0),
            self.block(t, self.values, self.values, self.first_value_row),
        )


class ShaderTable(WrappedBRDF):
    """The BRDF of a table, computed as the shader does, with the table's own sampling.

    Attributes:
        theta_i_rad: angles of incidence in radians, increasing, shape (T,).
        texels: texels of the texture, half floats, shape (height, width, 4).
        factor: factor on the products of values and normal distribution.
        lobes: lobes from which directions are sampled.
    """

    def __init__(self, shape: Shape, theta_i_rad: Array, texels: Halves, factor: float, lobes: Lobes) -> None:
        """Take the parts of a table, see `tabulate`."""
        self.shape, self.theta_i_rad, self.texels = shape, theta_i_rad, texels
        self.factor, self.lobes = factor, lobes
        self.bands, self.is_isotropic = Bands(None), True

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, linear sRGB, shape (..., 3)."""
        cosine = np.asarray(wo, float)[..., 2:]
        f_cos = self.eval_cos(wi, wo)
        return np.divide(f_cos, cosine, out=np.zeros_like(f_cos), where=cosine > 0.0)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, linear sRGB, shape (..., 3)."""
        pairs = Pairs(wi, wo)
        theta_i, _, x, y, cosine = pairs.located(True, 1).T
        lower, share = incidence(self.theta_i_rad, theta_i)
        upper, shape = lower + 1, self.shape
        sums = _mixed(share, *(self._block(t, x, y, shape.columns, shape.rows, 0) for t in (lower, upper)))
        u = sums[:, 0] / np.maximum(sums[:, 1], _LEAST_TOTAL)
        size = shape.values, shape.values, shape.first_value_row
        f = _mixed(share, *(self._block(t, u, sums[:, 2], *size) for t in (lower, upper)))
        row = self._texels[shape.normal_row, : shape.nodes]
        nodes = np.linspace(0.0, 1.0, shape.nodes)
        area = np.interp(np.sqrt(theta_i * 2.0 / np.pi), nodes, row[:, 1])
        f *= (self.factor * np.interp(x, nodes, row[:, 0]) / area)[:, None]
        f[cosine <= 0.0] = 0.0
        return f.reshape(*pairs.shape, 3)

    def _block(
        self, t: NDArray[np.intp], x: Array, y: Array, columns: int, rows: int, first_row: int
    ) -> Array:
        """Return values of the blocks of incidences t at coordinates in [0, 1], all (K,), shape (K, 3)."""
        row, column = np.divmod(t, self.shape.width // columns)
        (j, tx), (i, ty) = _cell(x, columns), _cell(y, rows)
        i, j = i + first_row + row * rows, j + column * columns
        low, high = (_mixed(tx, self._texels[k, j], self._texels[k, j + 1]) for k in (i, i + 1))
        return _mixed(ty, low, high)

    @cached_property
    def _texels(self) -> Array:
        return self.texels[..., :3].astype(float)

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr, shape (...)."""
        pairs = Pairs(wi, wo)
        return self.lobes.pdf(pairs.wi, pairs.wo).reshape(pairs.shape)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (..., 3) and their pdf (...) in 1/sr; pdf 0 marks an invalid sample."""
        flat_wi, flat_u, shape = flat_samples(wi, u)
        wo, pdf = self.lobes.sample(flat_wi, flat_u)
        return wo.reshape(*shape, 3), pdf.reshape(shape)


def incidence(theta_i_rad: Array, theta: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the index of the incidence below angles (K,), and the weight of the next one."""
    lower = np.clip(np.searchsorted(theta_i_rad, theta, side="right") - 1, 0, len(theta_i_rad) - 2)
    low, high = theta_i_rad[lower], theta_i_rad[lower + 1]
    return lower, np.clip((theta - low) / (high - low), 0.0, 1.0)


def tabulate(file: BsdfFile, shape: Shape, lobes: Lobes) -> ShaderTable:
    """Tabulate an isotropic file in linear sRGB at some of its incidences; `lobes` covers all of them."""
    kept = kept_incidences(len(file.theta_i_rad), shape.incidences)
    theta = np.asarray(file.theta_i_rad, float)[kept]
    texels = np.zeros((shape.height, shape.width, CHANNELS))
    data, conditional, marginal = cumulative_sums(file.vndf[:, kept])
    values = file.spectra[0, kept].astype(float)  # [T, 3, R, R]
    to_nodes = interpolation_matrix(np.linspace(0, 1, values.shape[-1]), np.linspace(0, 1, shape.values))
    values = np.moveaxis(to_nodes @ values @ to_nodes.T, 1, -1)
    ndf, sigma = (file.ndf, file.sigma) if file.jacobian else (np.ones((1, 2)), np.full((1, 2), 0.25))
    scales = [_unit(values), _unit(ndf)]
    for t in range(len(theta)):
        of_sums, of_values = shape.blocks(t)
        texels[of_sums][..., :3] = _sums(data[t], conditional[t], marginal[t], shape.columns, shape.rows)
        texels[of_values][..., :3] = values[t] / scales[0]
    row = texels[shape.normal_row, : shape.nodes]
    row[:, 0], row[:, 1] = _resampled(ndf, shape.nodes) / scales[1], _resampled(sigma, shape.nodes)
    lobes = Lobes(lobes.alphas, theta, lobes.weights[kept])
    return ShaderTable(shape, theta, texels.astype(np.float16), 0.25 * scales[0] * scales[1], lobes)


def kept_incidences(available: int, count: int) -> NDArray[np.intp]:
    """Return `count` evenly spaced indices of `available` incidences, including the first and the last."""
    return np.unique(np.rint(np.linspace(0, available - 1, count)).astype(np.intp))


def shapes_of(file: BsdfFile, most_bytes: int) -> list[Shape]:
    """Return the shapes of tables of a file that have at most `most_bytes` bytes, smallest first."""
    T, R = len(file.theta_i_rad), file.spectra.shape[-1]
    nodes = min(max(file.ndf.shape[1], file.sigma.shape[1]), _MOST_NODES) if file.jacobian else 2
    found = {
        Shape.of(incidences, values, columns, rows, nodes)
        for incidences in {T, -(-(T + 1) // 2), -(-(T + 3) // 4)}
        for values in {R, *(r for r in _VALUES if r < R)}
        for columns, rows in SUMS
        if incidences >= min(T, _LEAST_INCIDENCES)
    }
    return sorted(shape for shape in found if shape.bytes <= most_bytes)


SUMS = ((16, 12), (24, 12), (24, 16), (32, 16), (32, 24), (48, 24), (48, 32), (64, 32), (64, 48), (96, 64))
"""Columns and rows of the sums that are tried; polar angles of half vectors need more nodes than azimuths."""
_VALUES = (16, 24, 32, 48)  # nodes per axis of the values that are tried, and those of the file
_LEAST_INCIDENCES = 6  # files of the RGL database have eight


def _sums(data: Array, conditional: Array, marginal: Array, columns: int, rows: int) -> Array:
    """Return conditional sums, totals of the rows and marginal sums of a warp on a grid, (rows, columns, 3).

    Totals have the mean 1 over y.
    """
    R, C = data.shape
    j, tx = _cells(columns, C)
    i, ty = _cells(rows, R)
    first, second = data[:, j], data[:, j + 1]
    along = conditional[:, j] + tx * (first + 0.5 * tx * (second - first))  # [R, columns]
    total = conditional[:, -1]
    mixed = (1.0 - ty) * total[i] + ty * total[i + 1]
    below = marginal[i] + ty * (total[i] + 0.5 * ty * (total[i + 1] - total[i]))
    sums = np.empty((rows, columns, 3))
    sums[..., 0] = ((1.0 - ty)[:, None] * along[i] + ty[:, None] * along[i + 1]) * (R - 1)
    sums[..., 1], sums[..., 2] = (mixed * (R - 1))[:, None], below[:, None]
    return sums


def _cells(count: int, nodes: int) -> tuple[NDArray[np.intp], Array]:
    """Return the cell and the place inside of `count` even coordinates on some nodes."""
    at = np.linspace(0.0, nodes - 1.0, count)
    cell = np.minimum(at.astype(np.intp), nodes - 2)
    return cell, at - cell


def _resampled(table: Array, count: int) -> Array:
    """Return a table (A, N) of an isotropic file, the same at all azimuths, at `count` even nodes."""
    row = table.mean(axis=0, dtype=float)
    return np.interp(np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(row)), row)


def _unit(values: Array) -> float:
    """Return the power of two that scales values to `_LARGEST` at most."""
    largest = float(np.abs(values).max())
    return float(2.0 ** np.ceil(np.log2(largest / _LARGEST))) if largest > 0.0 else 1.0


def _mixed(share: Array, first: Array, second: Array) -> Array:
    """Return rows (K, 3) between two, the second with a share (K,)."""
    return np.asarray(first + share[:, None] * (second - first))


def _cell(coordinate: Array, nodes: int) -> tuple[NDArray[np.intp], Array]:
    at = np.clip(coordinate, 0.0, 1.0) * (nodes - 1)
    cell = np.minimum(at.astype(np.intp), nodes - 2)
    return cell, at - cell
