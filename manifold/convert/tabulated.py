"""BRDFs that interpolate dense tables or a goniometer's readings, and are exact at the nodes."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial import QhullError, cKDTree

from manifold.analytic.base import AnalyticBRDF
from manifold.core.directions import (
    from_spherical,
    half_vector,
    hemisphere_quadrature,
    normalize,
    to_rusinkiewicz,
    to_spherical,
)
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings

_LEAST_PER_INCIDENCE = 8  # directions that make a slice of a hemisphere
_HORIZON_COSINE = 1e-3
_SAME_ANGLE = 1e-4  # radians; incidences are rounded to five decimals
_DIFFUSE_PERCENTILE = 10  # percentile of a hemisphere's values: those away from highlights
_LARGEST_RATIO = 64.0
_LEAST_ALPHA = 0.05  # roughness of the masking, without which noise grows as 1 / cos into a bright rim


class TabulatedBRDF(AnalyticBRDF):
    """Base class of interpolated tables, which are 0 below the horizon and sampled in proportion to the cosine."""

    _isotropic: bool

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return self._isotropic

    def _albedo(self, wi: Array) -> Array:
        nodes, weights = hemisphere_quadrature(32, 64)
        return np.asarray(np.einsum("k,nkb->nb", weights, self.eval_cos(wi[:, None], nodes)))


class DenseBRDF(TabulatedBRDF):
    """A dense table interpolated linearly; unmeasured nodes have the value of the nearest measured node."""

    def __init__(self, table: DenseTable) -> None:
        """Take a dense table and fill its unmeasured nodes."""
        measured = table.measured
        if not np.any(measured):
            raise UsageError(f"{table.name}: nothing was measured, so there is nothing to interpolate")
        values = table.values
        if not np.all(measured):
            nearest = distance_transform_edt(
                np.logical_not(measured), return_distances=False, return_indices=True
            )
            values = values[tuple(nearest)]
        self.bands, self._isotropic = table.bands, table.is_isotropic
        self._coordinates, self._axes, self._values = table.coordinates, table.axes, values

    def _eval(self, wi: Array, wo: Array) -> Array:
        if self._coordinates == "half-difference":
            theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
            return self._blend([(theta_h, None), (theta_d, None), (phi_d, np.pi)])
        theta_i, phi_i = to_spherical(wi)
        theta_o, phi_o = to_spherical(wo)
        if self._isotropic:
            phi_o, phi_i = phi_o - phi_i + self._axes[1][0], np.full_like(phi_i, self._axes[1][0])
        return self._blend([(theta_i, None), (phi_i, 2 * np.pi), (theta_o, None), (phi_o, 2 * np.pi)])

    def _blend(self, angles: list[tuple[Array, float | None]]) -> Array:
        """Interpolate linearly in all angles (n,); periodic angles wrap round."""
        corners = [(np.zeros(angles[0][0].shape, dtype=int), np.ones(angles[0][0].shape))]
        for axis, (angle, period) in zip(self._axes, angles, strict=True):
            low, high, t = _bracket(axis, angle, period)
            size = axis.size
            corners = [
                (index * size + end, weight * w)
                for index, weight in corners
                for end, w in ((low, 1 - t), (high, t))
            ]
        flat = self._values.reshape(-1, self.bands.count)
        return np.asarray(sum(weight[:, None] * flat[index] for index, weight in corners))


def _bracket(axis: Array, angle: Array, period: float | None) -> tuple[Array, Array, Array]:
    """Return the indices of the nodes on both sides of each angle (n,), and its fraction between them."""
    if period is None or axis.size == 1:
        place = np.interp(angle, axis, np.arange(axis.size))
        low = np.minimum(place.astype(int), max(axis.size - 2, 0))
        return low, np.minimum(low + 1, axis.size - 1), place - low
    turned = (angle - axis[0]) % period
    place = np.interp(turned, np.append(axis - axis[0], period), np.arange(axis.size + 1))
    low = np.minimum(place.astype(int), axis.size - 1)
    return low, (low + 1) % axis.size, place - low


class ReadingsBRDF(TabulatedBRDF):
    """The interpolation of a goniometer's readings: a hemisphere of directions at each incidence.

    Between two incidences, values are interpolated at the same half vector, so that highlights move with the
    incidence and do not appear twice. The part above the diffuse level, including noise, is scaled like D F G / (4
    cos cos) of microfacets with the masking G of a smooth surface. Incidences beyond the last measured one are
    evaluated with wi and wo swapped.
    """

    def __init__(self, readings: Readings) -> None:
        """Group the readings by incidence."""
        finite = readings.measured.all(axis=1)
        if not np.any(finite):
            raise UsageError(
                f"{readings.name}: no direction was measured in all bands, which a BRDF needs; write CSV"
            )
        wi, wo, values = readings.wi[finite], readings.wo[finite], readings.values[finite]
        theta, phi = to_spherical(wi)
        phi = np.where(theta < 1e-6, 0.0, phi)
        keys = np.round(np.stack([theta, phi], axis=1), 5)
        incidences, group = np.unique(keys, axis=0, return_inverse=True)
        group = group.reshape(-1)
        self.bands = readings.bands
        oblique = incidences[incidences[:, 0] > 1e-6]
        self._isotropic = len(np.unique(oblique[:, 0])) == len(oblique)
        self._slices = []
        for k, (_, azimuth) in enumerate(incidences):
            rows = group == k
            turn = azimuth if self._isotropic else 0.0
            place = _disk(wo[rows], -turn)
            if self._isotropic:
                place, f = _both_sides(place, values[rows])
            else:
                f = values[rows]
            self._slices.append(_Slice(place, f, f"{readings.name}: {len(readings)} readings"))
        self._rings = [np.flatnonzero(incidences[:, 0] == t) for t in np.unique(incidences[:, 0])]
        self._thetas = np.unique(incidences[:, 0])
        self._phis = incidences[:, 1]

    def _eval(self, wi: Array, wo: Array) -> Array:
        swap = (wi[:, 2] < np.cos(self._thetas[-1] + _SAME_ANGLE)) & (wo[:, 2] > wi[:, 2])
        wi, wo = np.where(swap[:, None], wo, wi), np.where(swap[:, None], wi, wo)
        theta, phi = to_spherical(wi)
        h = half_vector(wi, wo)
        low, high, t = _bracket(self._thetas, theta, None)
        f = np.zeros((len(wi), self.bands.count))
        for ring in range(len(self._rings)):
            weight = (1 - t) * (low == ring) + t * (high == ring)
            rows = np.flatnonzero(weight > 0)
            if rows.size:
                cosines = _unmasked(wi[rows, 2]) * _unmasked(wo[rows, 2])
                f[rows] += weight[rows, None] * self._ring(ring, phi[rows], h[rows], cosines)
        return f

    def _ring(self, ring: int, phi: Array, h: Array, cosines: Array) -> Array:
        """Return values (n, B) for azimuths (n,), half vectors (n, 3) and products (n,) of `_unmasked` of both cosines.

        They are read at a polar angle of incidence that was measured.
        """
        theta, members = float(self._thetas[ring]), self._rings[ring]
        if self._isotropic:
            wo = _mirrored(from_spherical(theta, phi), h)
            return np.asarray(
                self._slices[members[0]](
                    _disk(wo, -phi), _unmasked(np.cos(theta)) * _unmasked(wo[:, 2]) / cosines
                )
            )
        low, high, t = _bracket(self._phis[members], phi, 2 * np.pi)
        f = np.zeros((len(phi), self.bands.count))
        for k, member in enumerate(members):
            weight = (1 - t) * (low == k) + t * (high == k)
            rows = np.flatnonzero(weight > 0)
            if rows.size:
                wi = from_spherical(theta, np.full(rows.size, self._phis[member]))
                wo = _mirrored(wi, h[rows])
                ratio = _unmasked(np.cos(theta)) * _unmasked(wo[:, 2]) / cosines[rows]
                f[rows] += weight[rows, None] * self._slices[member](_disk(wo, 0.0), ratio)
        return f


class _Slice:
    """Values on the disk of outgoing directions: linear on triangles, and the nearest value outside of them."""

    def __init__(self, place: Array, values: Array, what: str) -> None:
        """Triangulate places (n, 2) with values (n, B). Raises UsageError if that is impossible."""
        remedy = "do not determine a BRDF; complete them with a library (`manifold complete`)"
        if len(place) < _LEAST_PER_INCIDENCE:
            raise UsageError(f"{what}, {len(place)} at one incidence, {remedy}")
        try:
            self._inside = LinearNDInterpolator(place, values)
        except QhullError:
            raise UsageError(f"{what}, all in the plane of incidence, {remedy}") from None
        self._tree, self._values = cKDTree(place), values
        self._diffuse = np.percentile(values, _DIFFUSE_PERCENTILE, axis=0)

    def __call__(self, place: Array, ratio: Array) -> Array:
        """Return values (n, B) at places (n, 2).

        The part above the diffuse level is treated as D F G / (4 cos cos) of microfacets: it is multiplied by the
        ratio (n,) of the cosines of the slice to the cosines of the requested directions.
        """
        values = self._inside(place)
        outside = np.isnan(values).any(axis=1)
        if np.any(outside):
            values[outside] = self._values[self._tree.query(place[outside])[1]]
        lobe = np.maximum(values - self._diffuse, 0.0)
        return np.asarray(
            values + lobe * (np.clip(ratio, 1.0 / _LARGEST_RATIO, _LARGEST_RATIO) - 1.0)[:, None]
        )


def _unmasked(cosine: Array | float) -> Array:
    """Return cos / G1 of Smith's masking of a smooth GGX surface, up to a factor; positive at the horizon."""
    return np.asarray(cosine + np.sqrt(_LEAST_ALPHA**2 + (1.0 - _LEAST_ALPHA**2) * np.square(cosine)))


def _disk(w: Array, turn: Array | float) -> Array:
    """Return directions (n, 3), turned about the normal, as points of a disk whose radius is the polar angle."""
    theta, phi = to_spherical(w)
    return np.stack([theta * np.cos(phi + turn), theta * np.sin(phi + turn)], axis=-1)


def _mirrored(wi: Array, h: Array) -> Array:
    """Mirror wi at the half vectors (n, 3); directions below the horizon are moved to it."""
    wo = 2.0 * np.einsum("ni,ni->n", wi, h)[:, None] * h - wi
    wo[:, 2] = np.maximum(wo[:, 2], _HORIZON_COSINE)
    return normalize(wo)


def _both_sides(place: Array, values: Array) -> tuple[Array, Array]:
    """Mirror the measured half of an isotropic sample's disk if only that half was measured."""
    side = place[:, 1]
    if np.all(side > -_SAME_ANGLE) or np.all(side < _SAME_ANGLE):
        off = np.abs(side) > _SAME_ANGLE
        return np.concatenate([place, place[off] * [1.0, -1.0]]), np.concatenate([values, values[off]])
    return place, values
