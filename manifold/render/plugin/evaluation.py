"""Evaluates and samples the plugin `manifold` by sums over packed materials on Dr.Jit arrays."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.model.blending import NEGLIGIBLE
from manifold.render.plugin.mixture import Mixture
from manifold.render.plugin.packed_tables import ISOTROPIC, META, MOST_BANDS_AT_ONCE, SPECTRUM_PACKET
from manifold.render.plugin.warp import Family, PackedWarps, Slices, bisect


@dataclass(frozen=True, eq=False)
class LobeSums:
    """Common sums over the materials at the latents of all lanes.

    Attributes:
        latent: Q arrays, float64, without derivatives.
        sums: two arrays from which `VaryingWeights.weight` computes weights.
        slopes: derivatives of a sum with respect to the latents, Q arrays; empty if not needed.
        magnitude: sum of the absolute weights.
        offsets: Q arrays of value 0 with the derivatives of the latents.
    """

    latent: list[Any]
    sums: tuple[Any, Any]
    slopes: list[Any]
    magnitude: Any
    offsets: Sequence[Any] = ()


class VaryingWeights:
    """A function from latents to weights: a Gaussian process, or the blend of a map."""

    def __init__(self, mi: Any, dr: Any, mixture: Mixture) -> None:
        """Upload the latents of a mixture that has a process."""
        assert mixture.gp is not None
        self._mi, self._dr, self._gp, self._is_blend = mi, dr, mixture.gp, mixture.is_blend
        self._n, order = len(mixture.names), list(mixture.order)
        self._latents = [mi.Float64(np.ascontiguousarray(c)) for c in self._gp.X[order].T]
        if not self._is_blend:
            inverse = np.linalg.inv(self._gp.K)[np.ix_(order, order)]
            self._inverse_K, self._column_sums = mi.Float64(inverse.ravel()), mi.Float64(inverse.sum(axis=0))

    def at(self, latent: list[Any]) -> LobeSums:
        """Return the sums that the weights of all materials share at latents, given as Q arrays."""
        dr = self._dr
        x = [self._mi.Float64(v) for v in dr.detach(latent)]
        has_slopes = dr.grad_enabled(latent)
        lobes = self._of_blend(x, has_slopes) if self._is_blend else self._of_posterior(x, has_slopes)
        return replace(lobes, offsets=[v - dr.detach(v) for v in latent]) if has_slopes else lobes

    def weight(self, lobes: LobeSums, j: Any) -> tuple[Any, list[Any]]:
        """Return the weight of material j, and its derivatives in the latents if `lobes` has slopes."""
        mi, dr = self._mi, self._dr
        has_slopes = len(lobes.slopes) > 0
        if self._is_blend:
            nearest, total = lobes.sums
            share, *slopes = self._share(lobes.latent, j, nearest, has_slopes)
            v = share / total
            return mi.Float(v), [
                mi.Float((a - v * b) / total) for a, b in zip(slopes, lobes.slopes, strict=True)
            ]
        match, rest = lobes.sums
        v, *slopes = self._sum(
            lambda k: self._similarity(lobes.latent, k, has_slopes), self._inverse_K, j * self._n, has_slopes
        )
        is_free = match == self._n
        return mi.Float(dr.select(is_free, v + rest, dr.select(match == j, 1.0, 0.0))), [
            mi.Float(dr.select(is_free, a + b, 0.0)) for a, b in zip(slopes, lobes.slopes, strict=True)
        ]

    def _sum(self, terms: Any, factors: Any, first: Any, has_slopes: bool) -> list[Any]:
        """Sum terms(j), each a value and perhaps Q slopes, over the materials, times factors from `first` on."""
        mi, dr = self._mi, self._dr

        def add(j: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
            factor = 1.0 if factors is None else dr.gather(mi.Float64, factors, first + j)
            return j + 1, [dr.fma(factor, term, s) for term, s in zip(terms(j), sums, strict=True)]

        start = [mi.Float64(0.0)] * (1 + len(self._latents) * has_slopes)
        return list(dr.while_loop((mi.UInt32(0), start), lambda j, _: j < self._n, add)[1])

    def _first(self, start: Any, update: Any) -> Any:
        """Return the last state of a loop over the materials."""
        return self._dr.while_loop(
            (self._mi.UInt32(0), start), lambda j, _: j < self._n, lambda j, s: (j + 1, update(j, s))
        )[1]

    def _of_blend(self, latent: list[Any], has_slopes: bool) -> LobeSums:
        """Return the common part of `model.blending.blend_weights`, relative to the nearest material."""
        mi, dr = self._mi, self._dr

        def nearer(j: Any, found: tuple[Any, Any]) -> tuple[Any, Any]:
            cost = self._cost(latent, j)[0]
            return dr.minimum(cost, found[0]), dr.select(cost < found[0], j, found[1])

        nearest = self._first((mi.Float64(1e300), mi.UInt32(0)), nearer)[1]
        total, *slopes = self._sum(lambda j: self._share(latent, j, nearest, has_slopes), None, 0, has_slopes)
        return LobeSums(latent, (nearest, total), slopes, mi.Float(1.0))

    def _share(self, latent: list[Any], j: Any, nearest: Any, has_slopes: bool) -> list[Any]:
        """Return the share of material j before division by their sum, and its slopes."""
        dr = self._dr
        (cost, slope), (least, slope_nearest) = self._cost(latent, j), self._cost(latent, nearest)
        share = dr.exp(least - cost)
        kept = share - NEGLIGIBLE
        slopes = [
            dr.select(kept > 0.0, share * (slope_nearest * from_nearest - slope * d), 0.0)
            for d, from_nearest in zip(
                self._differences(latent, j), self._differences(latent, nearest), strict=True
            )
        ]
        return [dr.maximum(kept, 0.0), *slopes[: len(slopes) * has_slopes]]

    def _cost(self, latent: list[Any], j: Any) -> tuple[Any, Any]:
        """Return the negative logarithm of a share, and its derivative in the difference of latents."""
        unit = 1.0 / self._gp.kernel.length_scale**2
        squared = self._dr.maximum(self._squared_distance(latent, j) * unit, 1e-12)
        return 0.5 * squared + self._dr.log(squared), (1.0 + 2.0 / squared) * unit

    def _of_posterior(self, latent: list[Any], has_slopes: bool) -> LobeSums:
        """Return the common part of the Gaussian process's weights; a unit vector at a training latent."""
        mi, dr, n = self._mi, self._dr, self._n
        match = self._first(
            mi.UInt32(n),
            lambda j, s: dr.select((self._squared_distance(latent, j) < 1e-12) & (s == n), j, s),
        )
        total, *slopes = self._sum(
            lambda j: self._similarity(latent, j, has_slopes), self._column_sums, 0, has_slopes
        )
        rest, slopes = (1.0 - total) / n, [-slope / n for slope in slopes]
        lobes = LobeSums(latent, (match, rest), [], None)
        magnitude = self._first(mi.Float(0.0), lambda j, s: s + dr.abs(self.weight(lobes, j)[0]))
        return LobeSums(latent, lobes.sums, slopes, magnitude)

    def _similarity(self, latent: list[Any], j: Any, has_slopes: bool) -> list[Any]:
        """Return the covariance with material j, and its slopes."""
        dr, kernel = self._dr, self._gp.kernel
        unit = 1.0 / kernel.length_scale**2
        k, slope = kernel.radial(self._squared_distance(latent, j) * unit, dr)
        slopes = [2.0 * unit * slope * d for d in self._differences(latent, j)]
        return [k, *slopes[: len(slopes) * has_slopes]]

    def _differences(self, latent: list[Any], j: Any) -> list[Any]:
        pairs = zip(latent, self._latents, strict=True)
        return [x - self._dr.gather(self._mi.Float64, c, j) for x, c in pairs]

    def _squared_distance(self, latent: list[Any], j: Any) -> Any:
        return sum(self._dr.square(d) for d in self._differences(latent, j))


_DENSE_NM = 5.0  # largest distance of bands for which a wavelength takes the nearest one
_SYMMETRY = 17  # its entry of `Tables.meta`
_OFFSETS = (0, 1, 4, 5, 8, 11, 14)  # entries of `Tables.meta` that say where something begins


@dataclass(frozen=True, eq=False)
class _Group:
    """Consecutive materials whose tables have equal sizes.

    Attributes:
        first: meta data of the first, shape (META,).
        step: increment of the meta data from one material to the next.
    """

    start: int
    end: int
    first: Any
    step: Any

    @property
    def symmetry(self) -> int:
        """`ISOTROPIC`, or how often azimuths repeat in a turn."""
        return int(self.first[_SYMMETRY])

    @property
    def rotation_rad(self) -> float:
        """The azimuth by which the specimens were turned when they were measured."""
        return float(np.uint32(self.first[_SYMMETRY + 1]).view(np.float32))

    @classmethod
    def all_of(cls, meta: Any) -> list[_Group]:
        """Group the materials with meta data (N, META)."""
        sizes = np.delete(meta, _OFFSETS, axis=1)
        breaks = np.flatnonzero(np.any(sizes[1:] != sizes[:-1], axis=1)) + 1
        edges = [0, *breaks.tolist(), len(meta)]
        return [cls(a, b, meta[a], meta[min(a + 1, b - 1)] - meta[a]) for a, b in itertools.pairwise(edges)]


class Evaluation:
    """Evaluates and samples a mixture in the variant that is set."""

    def __init__(self, mi: Any, dr: Any, mixture: Mixture) -> None:
        """Upload the packed tables to Dr.Jit arrays."""
        self._mi, self._dr = mi, dr
        tables = mixture.tables
        self._n = len(mixture.names)
        self._groups = _Group.all_of(tables.meta.reshape(-1, META).astype(np.int64))
        self._n_theta, self._n_phi = tables.n_theta, tables.n_phi
        self._n_stored, self._has_samples = tables.n_bands, False
        self._slopes: list[Any] = []
        self._offsets: list[Any] = []
        self._meta = mi.UInt32(tables.meta)
        self._theta_nodes, self._phi_nodes = mi.Float(tables.theta_nodes), mi.Float(tables.phi_nodes)
        self._grids = mi.Float(tables.grids)
        self._is_half = tables.spectra.dtype == np.float16
        self._spectra = (mi.Float16 if self._is_half else mi.Float)(tables.spectra)
        self._warps = PackedWarps(
            mi, dr, mi.Float(tables.warps), mi.Float(tables.marginals), tables.most_nodes
        )
        self._mapping = mixture.mapping
        self._is_rgb = mixture.bands.is_rgb
        self._is_clipped = mixture.is_clipped
        if mixture.bands.wavelengths_nm is not None:
            self._wavelengths = mi.Float(np.asarray(mixture.bands.wavelengths_nm, dtype=np.float32))
            self._n_bands = mixture.bands.count
            self._is_dense = bool(np.diff(mixture.bands.wavelengths_nm).max() <= _DENSE_NM)
        self.set_weights(mixture)
        self._varying = None if mixture.gp is None else VaryingWeights(mi, dr, mixture)

    # -- weights -------------------------------------------------------------------------------------------

    def set_weights(self, mixture: Mixture, latent: Any = None, colours: Any = None) -> None:
        """Set the weights to those of a mixture of the same materials.

        If derivatives pass through the weights, their derivatives in the latent (Q,) and the given colours (B,) are
        kept.
        """
        mi, dr = self._mi, self._dr
        self._lobe_ends = mi.Float(np.cumsum(mixture.lobes).astype(np.float32))
        self._lobe_shares = mi.Float(mixture.lobes.astype(np.float32))
        if mixture.weights is None:
            return
        self._has_samples = mixture.weights.ndim == 3
        self._weights, *self._slopes = map(self._uploaded, (mixture.weights, *mixture.slopes))
        # Zeros with derivatives.
        self._offsets = [v - dr.detach(v) for v in (latent, colours) if v is not None]

    def _uploaded(self, weights: Array) -> Any:
        """Upload weights of materials, or of samples in their padded layout."""
        if self._has_samples:
            weights = np.pad(weights, ((0, 0), (0, 0), (0, self._n_stored - weights.shape[2])))
        return self._mi.Float(weights.astype(np.float32).ravel())

    def weights(self, latent: list[Any] | None) -> LobeSums | None:
        """Return weights at latents, a list of Q arrays; None for a fixed mixture, which has its own."""
        return None if latent is None or self._varying is None else self._varying.at(latent)

    def _weight(
        self, lobes: LobeSums | None, i: Any, has_slopes: bool, active: Any
    ) -> tuple[Any, Any, list[Any]]:
        """Return the weight of material i, its share in sampling, and slopes of the weight if asked for."""
        mi, dr = self._mi, self._dr
        if lobes is not None and self._varying is not None:
            v, slopes = self._varying.weight(lobes, i)
            return v, dr.abs(v) / lobes.magnitude, slopes
        share = dr.gather(mi.Float, self._lobe_shares, i, active)
        if self._has_samples:
            return None, share, []
        arrays = [self._weights, *self._slopes[: len(self._slopes) * has_slopes]]
        weight, *slopes = (dr.gather(mi.Float, array, i, active) for array in arrays)
        return weight, share, slopes

    def _offsets_at(self, lobes: LobeSums | None, bands: Any) -> list[Any]:
        """Return the factors of the slopes: 0, with the derivatives of parameters; none without differentiation."""
        mi, dr = self._mi, self._dr
        if lobes is not None:
            return list(lobes.offsets)
        if not self._slopes or not dr.grad_enabled(self._offsets):
            return []
        latent, *colours = self._offsets
        offsets = [dr.gather(mi.Float, latent, mi.UInt32(q)) for q in range(dr.width(latent))]
        for offset in colours:
            at = [[0, 1, 2]] if self._is_rgb else [[b for b, _ in bands], [b + 1 for b, _ in bands]]
            offsets += [
                mi.Spectrum(*(dr.gather(mi.Float, offset, mi.UInt32(b)) for b in some)) for some in at
            ]
        return offsets

    # -- one material --------------------------------------------------------------------------------------

    def _families(self, i: Any, active: Any) -> tuple[Family, Family, list[Any]]:
        """Return the warps of visible normals and luminance, and all other numbers of material i."""
        meta = self._dr.gather(self._mi.ArrayXu, self._meta, i, active, shape=(META, self._dr.width(i)))
        m = [meta[k] for k in range(META)]
        return Family(*m[0:4]), Family(*m[4:8]), m[8:]

    def _families_of(self, group: _Group, i: Any) -> tuple[Family, Family, list[Any]]:
        """Return `_families` of a material in a group, with sizes as numbers that the compiler knows."""
        m: list[Any] = [
            int(first) + (i - group.start) * int(step) if k in _OFFSETS else int(first)
            for k, (first, step) in enumerate(zip(group.first, group.step, strict=True))
        ]
        return Family(*m[0:4]), Family(*m[4:8]), m[8:]

    def _slices(self, i: Any, theta: Any, phi: Any, n_theta: Any, n_phi: Any, active: Any) -> Slices:
        """Return the slices around incident directions: polar angles around theta, azimuths around phi if any."""
        dr = self._dr
        (low, high), t = self._around(self._theta_nodes, self._n_theta, i, theta, n_theta, active)
        if (n_phi if isinstance(n_phi, int) else self._n_phi) == 1:
            return Slices([(low, low, high)], t, 0.0)
        azimuths, s = self._around(self._phi_nodes, self._n_phi, i, phi, n_phi, active)
        n_pairs = dr.maximum(n_theta - 1, 1)
        return Slices([(p * n_pairs + low, p * n_theta + low, p * n_theta + high) for p in azimuths], t, s)

    def _around(
        self, nodes: Any, most: int, i: Any, value: Any, n: Any, active: Any
    ) -> tuple[tuple[Any, Any], Any]:
        """Return the two of material i's n nodes around a value, and the weight of the second."""
        mi, dr = self._mi, self._dr
        first = i * most
        low, high = bisect(
            mi, dr, n, max(1, (most - 1).bit_length()),
            lambda m: dr.gather(mi.Float, nodes, first + m, active) <= value,
        )  # fmt: skip
        a, b = (dr.gather(mi.Float, nodes, first + k, active) for k in (low, high))
        return (low, high), dr.select(b > a, dr.clip((value - a) / (b - a), 0.0, 1.0), 0.0)

    def _in_its_frame(self, symmetry: Any, rotation: Any, wi: Any) -> tuple[Any, Any]:
        """Return cosine and sine of the turn into the sample's measured frame, and signs for each axis after it.

        The signs move incident directions into the measured azimuths.
        """
        mi, dr = self._mi, self._dr
        turn = mi.Vector2f(dr.cos(rotation), dr.sin(rotation))
        w = _turned(mi, wi, turn)
        y = dr.select((w.y >= 0.0) & (symmetry >= 2), -1.0, 1.0)
        x = dr.select(symmetry == 4, dr.select(w.x >= 0.0, -1.0, 1.0), y)
        return turn, mi.Vector3f(x, y, 1.0)

    def _grid(self, grid: list[Any], x: Any, y: Any, active: Any) -> Any:
        """Return the bilinear value of a packed grid, given by its first cell, its rows and columns."""
        dr = self._dr
        cells, rows, columns = grid
        j, tx = self._warps.cell(x, columns)
        i, ty = self._warps.cell(y, rows)
        c = dr.gather(self._mi.Vector4f, self._grids, cells + i * (columns - 1) + j, active)
        return dr.lerp(dr.lerp(c.x, c.y, tx), dr.lerp(c.z, c.w, tx), ty)

    # -- sums over materials -------------------------------------------------------------------------------

    def eval_pdf(
        self, lobes: LobeSums | None, wi: Any, wo: Any, wavelengths: Any, active: Any
    ) -> tuple[Any, Any]:
        """Return f * cos(theta_o) as a spectrum and the density of `sample`, both in 1/sr.

        The value has derivatives with respect to the latent.
        """
        mi, dr = self._mi, self._dr
        if dr.grad_enabled(wi, wo):
            raise UsageError(
                "plugin manifold: derivatives with respect to directions (moved shapes, lights or cameras) are not "
                "supported; keep these fixed"
            )
        cos_o = mi.Frame3f.cos_theta(wo)
        cosines = cos_o * mi.Frame3f.cos_theta(wi)
        m = dr.normalize(wi + wo)
        theta_i, theta_m = _elevation(mi, dr, wi), _elevation(mi, dr, m)
        ux = dr.sqrt(theta_m * (2.0 / math.pi))
        sigma_x = dr.sqrt(theta_i * (2.0 / math.pi))
        bands = None if self._is_rgb else self._locate_bands(wavelengths)
        jacobian = dr.maximum(2.0 * math.pi**2 * ux * dr.sin(theta_m), 1e-6) * 4.0 * dr.dot(wi, m)

        def add(i: Any, total: Any, tangents: list[Any], density: Any) -> Any:
            visible, luminance, rest = self._families_of(group, i)
            slices = self._slices(i, theta_i, phi_i, rest[7], rest[8], active)
            u, v, pdf = self._warps.invert(visible, slices, ux, uy, active)
            pdf *= self._warps.density(luminance, slices, u, v, active)
            scale = self._grid(rest[0:3], ux, uy, active) / (
                self._grid(rest[3:6], sigma_x, sigma_y, active) * cos_o
            )
            weight, share, slopes = self._weight(lobes, i, has_slopes, active)
            values = self._spectrum(rest[6], luminance, slices, u, v, bands, scale, cosines, active)
            if weight is None:
                value, *changes = self._combined(values, i, bands, has_slopes, active)
            else:
                value, *changes = (values * w for w in (weight, *slopes))
            tangents = [tangent + change for tangent, change in zip(tangents, changes, strict=True)]
            return i + 1, total + value, tangents, density + share * pdf

        # Sums with slopes of the weights, not derivatives through the loop: those of Dr.Jit 1.5 fail for several loops.
        offsets = self._offsets_at(lobes, bands)
        has_slopes = len(offsets) > 0
        total, tangents, density = mi.Spectrum(0.0), [mi.Spectrum(0.0) for _ in offsets], mi.Float(0.0)
        for group in self._groups:
            turn, sign = self._in_its_frame(group.symmetry, group.rotation_rad, wi)
            phi_i, phi_m = (_azimuth(dr, sign * _turned(mi, w, turn)) for w in (wi, m))
            uy = (phi_m - phi_i if group.symmetry == ISOTROPIC else phi_m) / (2.0 * math.pi) + 0.5
            uy -= dr.floor(uy)
            sigma_y = phi_i / (2.0 * math.pi) + 0.5
            _, total, tangents, density = dr.while_loop(
                (mi.UInt32(group.start), total, tangents, density),
                lambda i, *_, end=group.end: i < end,
                add,
                labels=("material", "sum", "tangents", "density"),
            )
        total += sum(tangent * offset for tangent, offset in zip(tangents, offsets, strict=True))
        f = self._mapping.inverse(total, cosines, dr)
        if self._is_clipped:
            f = dr.maximum(f, 0.0)
        return f * cos_o, density / jacobian

    def _spectrum(
        self, cells: Any, grid: Family, slices: Slices, u: Any, v: Any, bands: Any,
        scale: Any, cosines: Any, active: Any,
    ) -> Any:  # fmt: skip
        """Return mapped values of one material at the warped point (u, v): all bands, or its sample bands only."""
        mi, dr = self._mi, self._dr
        j, tx = self._warps.cell(u, grid.columns)
        i, ty = self._warps.cell(v, grid.rows)
        at_one = ((1 - ty) * (1 - tx), (1 - ty) * tx, ty * (1 - tx), ty * tx)
        corners = [weight_t * w for weight_t in (1 - slices.t, slices.t) for w in at_one]
        shares = [1.0] if len(slices.at) == 1 else [1.0 - slices.s, slices.s]
        packets = [
            (cells + (pair * (grid.rows - 1) + i) * (grid.columns - 1) + j, [share * w for w in corners])
            for (pair, _, _), share in zip(slices.at, shares, strict=True)
        ]

        def forward(value: Any) -> Any:
            return self._mapping.forward(value * scale, cosines, dr)

        if self._is_rgb or self._has_samples:
            mapped = [forward(value) for value in self._all_bands(packets, active)]
            return mapped if self._has_samples else mi.Spectrum(*mapped[:3])
        values = []
        for band, s in bands:
            if self._is_dense:  # reading one band instead of two saves more than a quarter of the time
                values.append(forward(self._band(packets, band + dr.select(s > 0.5, 1, 0), active)))
            else:
                below, above = (self._band(packets, k, active) for k in (band, band + 1))
                values.append(forward(dr.lerp(below, above, s)))
        return mi.Spectrum(*values)

    def _all_bands(self, packets: list[tuple[Any, list[Any]]], active: Any) -> list[Any]:
        """Return values of all bands of cells by the weights of their corners, in one read if there are few bands."""
        if self._n_stored > MOST_BANDS_AT_ONCE:
            return [self._band(packets, band, active) for band in range(self._n_stored)]
        n = SPECTRUM_PACKET * self._n_stored
        read = [
            (
                self._dr.gather(
                    self._mi.ArrayXf, self._spectra, cell, active, shape=(n, self._dr.width(cell))
                ),
                corners,
            )
            for cell, corners in packets
        ]
        return [
            sum(
                w * packet[SPECTRUM_PACKET * band + c]
                for packet, corners in read
                for c, w in enumerate(corners)
            )
            for band in range(self._n_stored)
        ]

    def _band(self, packets: list[tuple[Any, list[Any]]], band: Any, active: Any) -> Any:
        """Return the value of one band of cells by the weights of their corners."""
        dr, mi = self._dr, self._mi
        stored = dr.float16_array_t(mi.ArrayXf) if self._is_half else mi.ArrayXf
        total = 0.0
        for cell, corners in packets:
            index = cell * self._n_stored + band
            packet = dr.gather(stored, self._spectra, index, active, shape=(SPECTRUM_PACKET, dr.width(index)))
            total += sum(w * mi.Float(packet[c]) for c, w in enumerate(corners))
        return total

    def _combined(
        self, mapped: list[Any], material: Any, bands: Any, has_slopes: bool, active: Any
    ) -> list[Any]:
        """Return sums over the samples of a material, by the weights and by their slopes.

        The slopes have the order of `_offsets_at`.
        """
        mi, dr, n = self._mi, self._dr, self._n_stored

        def dot(array: Any, band: Any) -> Any:
            index = mi.UInt32(band) * self._n + material
            weights = dr.gather(mi.ArrayXf, array, index, active, shape=(n, dr.width(material)))
            return sum(weights[k] * mapped[k] for k in range(n))

        def spectra(array: Any) -> list[Any]:
            """Return the sums of the bands, or the parts of the bands below and above the wavelengths."""
            if self._is_rgb:
                return [mi.Spectrum(*(dot(array, b) for b in range(3)))]
            below, above = (
                ((1.0 - s) * dot(array, b) for b, s in bands),
                (s * dot(array, b + 1) for b, s in bands),
            )
            return [mi.Spectrum(*below), mi.Spectrum(*above)]

        sums = [sum(spectra(self._weights))]
        if has_slopes:
            n_latent = dr.width(self._offsets[0])
            sums += [sum(spectra(array)) for array in self._slopes[:n_latent]]
            sums += [part for array in self._slopes[n_latent:] for part in spectra(array)]
        return sums

    def _locate_bands(self, wavelengths: Any) -> list[tuple[Any, Any]]:
        """Return the band below each wavelength, and the fraction of the way to the next; constant outside."""
        mi, dr = self._mi, self._dr
        located = []
        for wavelength in wavelengths:
            k = dr.binary_search(
                0, self._n_bands - 1, lambda m, w=wavelength: dr.gather(mi.Float, self._wavelengths, m) <= w
            )
            k = mi.UInt32(dr.clip(mi.Int32(k) - 1, 0, self._n_bands - 2))
            a = dr.gather(mi.Float, self._wavelengths, k)
            b = dr.gather(mi.Float, self._wavelengths, k + 1)
            located.append((k, dr.clip((wavelength - a) / (b - a), 0.0, 1.0)))
        return located

    # -- sampling ------------------------------------------------------------------------------------------

    def sample(self, lobes: LobeSums | None, wi: Any, sample1: Any, sample2: Any, active: Any) -> Any:
        """Sample outgoing directions; those below the horizon have no weight."""
        mi, dr = self._mi, self._dr
        i = self._choose(lobes, sample1)
        visible, luminance, rest = self._families(i, active)
        n_theta, n_phi, symmetry, rotation_bits = rest[7:11]
        turn, sign = self._in_its_frame(symmetry, dr.reinterpret_array(mi.Float, rotation_bits), wi)
        phi_i = _azimuth(dr, sign * _turned(mi, wi, turn))
        slices = self._slices(i, _elevation(mi, dr, wi), phi_i, n_theta, n_phi, active)
        x, y = self._warps.sample(luminance, slices, sample2.y, sample2.x, active)
        ux, uy = self._warps.sample(visible, slices, x, y, active)
        theta_m = ux * ux * (0.5 * math.pi)
        phi_m = (2.0 * uy - 1.0) * math.pi + dr.select(symmetry == ISOTROPIC, phi_i, 0.0)
        (sin_p, cos_p), (sin_t, cos_t) = dr.sincos(phi_m), dr.sincos(theta_m)
        m = _turned(mi, sign * mi.Vector3f(cos_p * sin_t, sin_p * sin_t, cos_t), mi.Vector2f(turn.x, -turn.y))
        cos_im = dr.dot(wi, m)
        wo = 2.0 * cos_im * m - wi
        return dr.select(cos_im > 0.0, wo, mi.Vector3f(0.0, 0.0, -1.0))

    def _choose(self, lobes: LobeSums | None, sample1: Any) -> Any:
        """Choose a material per lane, by its share."""
        mi, dr, varying = self._mi, self._dr, self._varying
        if lobes is None or varying is None:
            i = dr.binary_search(0, self._n - 1, lambda m: dr.gather(mi.Float, self._lobe_ends, m) < sample1)
            return mi.UInt32(i)
        target = sample1 * lobes.magnitude

        def step(i: Any, reached: Any, chosen: Any) -> Any:
            after = reached + dr.abs(varying.weight(lobes, i)[0])
            return i + 1, after, dr.select((after > target) & (reached <= target), i, chosen)

        return dr.while_loop(
            (mi.UInt32(0), mi.Float(0.0), mi.UInt32(self._n - 1)), lambda i, r, c: i < self._n, step
        )[2]


def _elevation(mi: Any, dr: Any, w: Any) -> Any:
    """Return the angle from the normal, stable near it."""
    return 2.0 * dr.asin(dr.minimum(0.5 * dr.norm(w - mi.Vector3f(0.0, 0.0, 1.0)), 1.0))


def _azimuth(dr: Any, w: Any) -> Any:
    return dr.atan2(w.y, w.x)


def _turned(mi: Any, w: Any, turn: Any) -> Any:
    """Turn vectors about the normal by an angle with this cosine and sine."""
    return mi.Vector3f(turn.x * w.x - turn.y * w.y, turn.y * w.x + turn.x * w.y, w.z)
