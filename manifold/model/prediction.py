"""Predicted BRDFs: weighted sums of measured BRDFs in a mapped domain, evaluated on demand, and their sampling."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np

from manifold.analytic.base import choose_lobe, cosine_hemisphere
from manifold.analytic.free_lobes import Lobes
from manifold.analytic.ggx import normal_distribution, sample_normals
from manifold.brdf.interface import BRDF, all_isotropic, require_resolution
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.notebook import NotebookPicture
from manifold.brdf.plausibility import quadrature_albedo
from manifold.brdf.sums import WeightedSum
from manifold.brdf.wrapper import WrappedBRDF
from manifold.core.directions import half_vector
from manifold.core.errors import ShapeError, UsageError
from manifold.core.mapping import CubeRoot, Identity, ValueMapping
from manifold.core.pairs import Pairs, flat_samples, value_type
from manifold.core.records import Array, Bands
from manifold.core.threads import one_blas_thread, share_out
from manifold.model.combination import Combination


class LobeSampling:
    """Samples directions of analytic lobes from their normal distributions and a cosine lobe."""

    def __init__(self, lobes: Lobes, weights: Array) -> None:
        """Sample lobes in proportion to weights (n_l,), at least 0 and not all zero."""
        shape = lobes.shape_of(np.arange(len(lobes)))
        totals = np.bincount(shape + 1, weights)
        self._shapes = [None, *lobes.shapes]  # the Lambertian first
        self._shares = totals / totals.sum()

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr, shape (...); 0 below the horizon."""
        wi, wo = np.broadcast_arrays(wi, wo)
        up = (wi[..., 2] > 0.0) & (wo[..., 2] > 0.0)
        h = half_vector(wi[up], wo[up])
        cos_h = h[:, 2]
        per_normal = cos_h / (4.0 * np.maximum(np.sum(wi[up] * h, axis=1), 1e-9))
        found = np.zeros(len(h))
        for share, shape in zip(self._shares, self._shapes, strict=True):
            if share > 0.0 and shape is None:
                found += share * wo[up][:, 2] / np.pi
            elif share > 0.0 and shape is not None:
                found += share * normal_distribution(cos_h, *shape) * per_normal
        density = np.zeros(up.shape)
        density[up] = found
        return density

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (P, 3) and their pdf (P,) for wi (P, 3) and variates u (P, 2) in [0, 1).

        A pdf of 0 marks an invalid sample.
        """
        chosen, u = choose_lobe(self._shares, u)
        wo = cosine_hemisphere(u)
        for k, shape in enumerate(self._shapes):
            mine = chosen == k
            if shape is not None and np.any(mine):
                h = sample_normals(u[mine], *shape)
                wo[mine] = 2.0 * np.sum(wi[mine] * h, axis=1, keepdims=True) * h - wi[mine]
        return wo, self.pdf(wi, wo)


BLOCK_PAIRS = 512  # direction pairs summed at once: of 195 bands 0.4 MB, which stay in a core's own cache
_BLOCKS = 8  # least number of blocks, where there are enough pairs: threads share them
_SHOWN_PARTS = 3


class PredictedBRDF(NotebookPicture):
    """A weighted sum of measured BRDFs in a mapped domain, `T^-1(sum_i v_i T(f_i))`, evaluated on demand.

    The weights belong to whole materials and are the same in all bands, or they belong to single bands of materials
    and to analytic lobes and differ between the predicted bands (`Combination`). If a single material has the weight
    1, the prediction equals the measured BRDF bit for bit, for every mapping.
    Source: Hikichi & Iwasaki, eq. 13, written as weights of the measured materials; docs/explanation/gplvm.md.
    """

    def __init__(self, materials: Sequence[BRDF], combination: Combination, bands: Bands | None = None):
        """Combine N materials of the same bands, or their sample bands if single bands are combined.

        `bands` are those to predict.
        """
        for material in materials[1:]:
            materials[0].bands.require_same(material.bands, "materials of a prediction", "use one library")
        self.bands = materials[0].bands if bands is None else bands
        self._mapping = combination.mapping
        self._dictionary = combination.dictionary
        self._is_per_band = combination.sample_bands is not None
        weights = np.asarray(combination.weights, dtype=np.float64)
        if not np.any(weights):
            raise ShapeError("all weights are zero (black); choose a colour with a reflectance above 0")
        expected: tuple[int, ...] = (len(materials),)
        if self._is_per_band:
            n_samples = len(materials) * materials[0].bands.count
            n_atoms = n_samples if self._dictionary is None else self._dictionary.size(n_samples)
            expected = (self.bands.count, n_atoms)
        if weights.shape != expected or not np.all(np.isfinite(weights)):
            raise ShapeError(f"weights have shape {weights.shape}, expected {expected}, all finite")
        if self._is_per_band:
            self._materials, self._weights = list(materials), weights  # [B, N B_s], or [B, n']
            shares, lobes = self._sampled_parts(np.abs(weights).sum(axis=0))
        else:
            used = np.flatnonzero(weights)
            self._materials = [materials[int(k)] for k in used]
            self._weights = weights[used]
            shares, lobes = np.abs(self._weights), []
        self.is_isotropic = all_isotropic(self._materials)
        is_one = not self._is_per_band and len(self._materials) == 1 and self._weights[0] == 1.0
        self._measured = self._materials[0] if is_one else None
        # Sampling needs a density that covers every part with a weight, not the exact shape of the sum.
        self._sampling_weights = shares / shares.sum()
        self._samplers: list[BRDF | LobeSampling] = [*self._materials, *lobes]

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and other processes need: all but `_sums`, which are prepared at first use."""
        return {name: value for name, value in vars(self).items() if name != "_sums"}

    def __repr__(self) -> str:
        names = [name for name, _ in self.parts]
        more = ", ..." if len(names) > _SHOWN_PARTS else ""
        return f"<PredictedBRDF: {self.bands}, of {', '.join(names[:_SHOWN_PARTS])}{more}>"

    @property
    def parts(self) -> list[tuple[str, float]]:
        """Return the combined materials and analytic lobes with their shares of the sum of |weights|, largest first."""
        order = np.argsort(-self._sampling_weights, kind="stable")
        return [
            (getattr(self._samplers[k], "name", "analytic lobes"), float(self._sampling_weights[k]))
            for k in order
            if self._sampling_weights[k] > 0.0
        ]

    def _sampled_parts(self, totals: Array) -> tuple[Array, list[LobeSampling]]:
        """Return the sampling weights of materials and lobes, summed over their samples or atoms.

        Lobes without weight are dropped.
        """
        N, dictionary = len(self._materials), self._dictionary
        if dictionary is None:
            return totals.reshape(N, -1).sum(axis=1), []
        first = totals.size - len(dictionary.lobes)
        of_lobes = totals[first:]
        self._lobes = np.flatnonzero(of_lobes)
        self._weights = np.delete(self._weights, first + np.flatnonzero(of_lobes == 0.0), axis=1)
        shares = totals[:first].reshape(len(dictionary.exponents), N, -1).sum(axis=(0, 2))
        if self._lobes.size == 0:
            return shares, []
        return np.append(shares, of_lobes.sum()), [LobeSampling(dictionary.lobes, of_lobes)]

    def turned(self, angle_rad: float) -> PredictedBRDF:
        """Return the BRDF turned about the normal by an azimuth in radians.

        The tables of measured materials are shared.

        Raises:
            UsageError: the azimuth is not finite.
        """
        if not math.isfinite(angle_rad):
            raise UsageError(f"found an azimuth of {angle_rad}, expected radians")
        if angle_rad == 0.0 or self.is_isotropic:
            return self
        turned = copy.copy(self)
        turned._materials = [cast(MeasuredBRDF, material).turned(angle_rad) for material in self._materials]
        turned._measured = None if self._measured is None else turned._materials[0]
        turned._samplers = [*turned._materials, *self._samplers[len(self._materials) :]]
        return turned

    def eval(self, wi: Array, wo: Array, out: Array | None = None) -> Array:
        """Return f in 1/sr, shape (..., B), at unit vectors (..., 3) that broadcast against each other.

        Values can be negative if weights are negative, or if the measured file has negative values. `out`, precision
        and errors are as in `MeasuredBRDF.eval`.
        """
        if self._measured is not None and out is None:
            return self._measured.eval(wi, wo)
        pairs = Pairs(wi, wo)
        out = pairs.results(self.bands.count, out, value_type(wi, wo))
        if self._measured is not None:
            out[...] = self._measured.eval(wi, wo)
            return out
        values = out.reshape(len(pairs), self.bands.count)
        # Few pairs are shared out too, but not so finely that calls take longer than values. Sums of matrices depend on
        # the size of blocks, which therefore does not depend on the number of threads.
        size = int(np.clip(-(-len(pairs) // _BLOCKS), 64, BLOCK_PAIRS))
        blocks = [(block, values[rows]) for rows, block in pairs.blocks(size)]
        if len(blocks) > 1 and all(isinstance(material, MeasuredBRDF) for material in self._materials):
            # Every thread multiplies matrices of its own: a second level of threads costs more than it does.
            with one_blas_thread:
                share_out(lambda block: self._combine(*block), blocks)
        else:  # other materials may have parallel loops of their own
            for block, of_block in blocks:
                self._combine(block, of_block)
        return out

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B); arguments and errors as in `eval`."""
        if self._measured is not None:
            return self._measured.eval_cos(wi, wo)
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2], 0.0)[..., None]

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr, shape (...): densities of materials and lobes, weighted by |v_i|."""
        shares = zip(self._sampling_weights, self._samplers, strict=True)
        return np.sum([share * sampler.pdf(wi, wo) for share, sampler in shares if share > 0.0], axis=0)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (..., 3) and their pdf (...) in 1/sr, for wi (..., 3) and variates u (..., 2).

        A pdf of 0 marks an invalid sample.
        """
        wi, u, shape = flat_samples(wi, u)
        lobe, u = choose_lobe(self._sampling_weights, u)
        wo = np.zeros_like(wi)
        wo[:, 2] = 1.0
        usable = np.zeros(len(wi), dtype=bool)
        for k, sampler in enumerate(self._samplers):
            mine = lobe == k
            if np.any(mine):
                wo[mine], pdf = sampler.sample(wi[mine], u[mine])
                usable[mine] = pdf > 0
        density = np.where(usable, self.pdf(wi, wo), 0.0)
        return wo.reshape(*shape, 3), density.reshape(shape)

    def albedo(self, wi: Array, resolution: int = 48) -> Array:
        """Return the directional albedo (..., B) at unit vectors wi (..., 3), by quadrature over half vectors.

        The result is in double precision. `resolution` is the number of nodes per axis.

        Raises:
            ShapeError: as in `eval`.
            UsageError: the resolution is not an integer of at least 4.
        """
        require_resolution(resolution)
        return quadrature_albedo(self, wi, resolution)

    def _combine(self, pairs: Pairs, out: Array) -> None:
        """Write the values of K direction pairs into out (K, B)."""
        cosines, dtype = pairs.cosines, self._sums[0].dtype
        mapped: Array
        if self._is_per_band:
            each = np.zeros((len(self._materials), len(pairs), self._materials[0].bands.count), dtype)
            for k, share in enumerate(self._sampling_weights[: len(self._materials)]):
                if share > 0.0:
                    self._sums[k].add_to(each[k], pairs)
            by_sample = np.array(np.moveaxis(each, 1, 2), np.float64, order="C")  # [N, B_s, K]
            samples = by_sample.reshape(-1, len(pairs))
            if self._dictionary is None:
                mapped = samples.T @ self._weights.T
            else:
                lobes = self._mapping.forward(self._dictionary.lobes.values(pairs.wi, pairs.wo, self._lobes))
                mapped = self._dictionary.combine(self._weights, samples, lobes).T
        else:
            mapped = np.zeros(out.shape, dtype)
            self._sums[0].add_to(mapped, pairs)
        out[...] = self._mapping.inverse(mapped, cosines[:, None])
        out[cosines <= 0] = 0.0

    @cached_property
    def _sums(self) -> list[WeightedSum | _MappedSum]:
        """Weighted sums of mapped materials: one sum, or one per material if weights differ by band."""
        parts: list[tuple[Sequence[BRDF], Array]] = [(self._materials, self._weights)]
        if self._is_per_band:
            parts = [([material], np.ones(1)) for material in self._materials]
        is_root = type(self._mapping) is CubeRoot  # a subclass may have another `forward`
        is_quick = is_root or type(self._mapping) is Identity
        return [
            WeightedSum(cast(Sequence[MeasuredBRDF], materials), weights, cube_root=is_root)
            if is_quick and all(isinstance(material, MeasuredBRDF) for material in self._materials)
            else _MappedSum(materials, weights, self._mapping)
            for materials, weights in parts
        ]


class _MappedSum:
    """The sum of weights * T(f) of any BRDFs and any mapping, one BRDF after the other."""

    dtype = np.float64  # of totals: logarithms need it

    def __init__(self, brdfs: Sequence[BRDF], weights: Array, mapping: ValueMapping):
        self._terms, self._mapping = list(zip(brdfs, weights, strict=True)), mapping

    def add_to(self, total: Array, pairs: Pairs) -> None:
        """Add the sum at K direction pairs to total (K, B)."""
        for brdf, weight in self._terms:
            total += weight * self._mapping.forward(values_at(brdf, pairs), pairs.cosines[:, None])


class ClippedBRDF(WrappedBRDF):
    """A BRDF whose negative values are set to zero, as files require; it counts these values."""

    def __init__(self, brdf: BRDF):
        """Wrap a BRDF."""
        super().__init__(brdf)
        self._seen = 0
        self._cut = 0

    @property
    def clipped_share(self) -> float:
        """Return the share of negative values among all values evaluated so far."""
        return self._cut / max(self._seen, 1)

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, at least 0, shape (..., B); arguments and errors as in the wrapped BRDF."""
        f = self._brdf.eval(wi, wo)
        self._seen += f.size
        self._cut += int(np.count_nonzero(f < 0))
        return np.maximum(f, 0.0)

    def albedo(self, wi: Array) -> Array:
        """Return the directional albedo (..., B) of the wrapped BRDF at wi (..., 3), including its negative values."""
        return self._brdf.albedo(wi)
