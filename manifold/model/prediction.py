"""Predicted BRDFs: weighted sums of measured ones in a mapped domain, evaluated only where asked."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numba as nb
import numpy as np

from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.plausibility import quadrature_albedo
from manifold.directions import require_directions
from manifold.errors import ShapeError
from manifold.mapping import CubeRoot, Identity, Mapping
from manifold.metrics import cosine_weight
from manifold.parallel import one_blas_thread
from manifold.records import Array, Bands
from manifold.synthetic.analytic import choose_lobe

# Direction pairs mapped at once: the sums of a block (195 bands: 3 MB) and one material's file share the last cache.
BLOCK_PAIRS = 2048


def _block_size(n_pairs: int) -> int:
    """Pairs per block: few pairs are shared out too, but not so finely that calls take longer than values."""
    return int(np.clip(-(-n_pairs // (2 * nb.get_num_threads())), 64, BLOCK_PAIRS))


class Mixture:
    """What predictions share: the materials they are made of, whose densities `sample` mixes.

    A subclass evaluates blocks of direction pairs in `_combine`.
    """

    def __init__(self, materials: Sequence[BRDF], sampling_weights: Array, bands: Bands) -> None:
        """Take N materials, their non-negative shares (N,) in the density of `sample`, and the bands to predict."""
        for material in materials[1:]:
            materials[0].bands.require_same(material.bands, "materials of a prediction", "use one library")
        self._materials = list(materials)
        # Sampling needs a density that covers every material that counts, not the exact shape of the sum.
        self._lobes = sampling_weights / sampling_weights.sum()
        self._bands = bands

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._bands

    @property
    def is_isotropic(self) -> bool:
        """Whether all materials with a weight are."""
        return all(material.is_isotropic for material in self._materials)

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B); may be negative where the mapping allows it.

        Args:
            wi, wo: unit vectors (..., 3) that broadcast against each other.
        Raises:
            ShapeError: a direction array is not (..., 3), not finite, or not of unit length.
        """
        pairs = DirectionPairs(wi, wo)
        out = np.empty((len(pairs), self.bands.count))
        blocks = [(block, out[rows]) for rows, block in pairs.blocks(_block_size(len(pairs)))]
        if len(blocks) > 1 and all(isinstance(material, MeasuredBRDF) for material in self._materials):
            # Every thread multiplies matrices of its own: a second level of threads costs more than it does.
            with one_blas_thread, ThreadPoolExecutor(nb.get_num_threads()) as pool:
                list(pool.map(self._combine, *zip(*blocks, strict=True)))
        else:  # other materials may have parallel loops of their own
            for block, values in blocks:
                self._combine(block, values)
        return out.reshape(*pairs.shape, out.shape[1])

    def _combine(self, pairs: DirectionPairs, out: Array) -> None:
        """Values of K direction pairs into out (K, B)."""
        raise NotImplementedError

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B); arguments and errors as in `eval`."""
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2], 0.0)[..., None]

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Density of `sample` in 1/sr, shape (...): the materials' densities, mixed by |v_i|."""
        return np.sum([p * m.pdf(wi, wo) for p, m in zip(self._lobes, self._materials, strict=True)], axis=0)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Outgoing directions (..., 3) and their pdf (...) in 1/sr; pdf 0 marks a sample to throw away.

        Args:
            wi: incident unit vectors (..., 3).
            u: uniform variates in [0, 1), shape (..., 2).
        Raises:
            ShapeError: wi is not (..., 3), or u is not (..., 2).
        """
        wi, u = require_directions(wi, "wi"), np.asarray(u, dtype=np.float64)
        if u.shape[-1:] != (2,):
            raise ShapeError(f"u has shape {u.shape}, expected (..., 2)")
        shape = np.broadcast_shapes(wi.shape[:-1], u.shape[:-1])
        wi = np.broadcast_to(wi, (*shape, 3)).reshape(-1, 3)
        u = np.broadcast_to(u, (*shape, 2)).reshape(-1, 2)
        lobe, u = choose_lobe(self._lobes, u)
        wo = np.zeros_like(wi)
        wo[:, 2] = 1.0
        usable = np.zeros(len(wi), dtype=bool)
        for k, material in enumerate(self._materials):
            mine = lobe == k
            if np.any(mine):
                wo[mine], pdf = material.sample(wi[mine], u[mine])
                usable[mine] = pdf > 0
        density = np.where(usable, self.pdf(wi, wo), 0.0)
        return wo.reshape(*shape, 3), density.reshape(shape)

    def albedo(self, wi: Array, resolution: int = 48) -> Array:
        """Directional albedo, shape (..., B), by quadrature over half vectors.

        Args:
            wi: incident unit vectors (..., 3).
            resolution: nodes in elevation and in azimuth.
        """
        return quadrature_albedo(self, wi, resolution)


class PredictedBRDF(Mixture):
    """T^-1(sum_i v_i T(f_i)): a BRDF between measured materials.

    With a unit vector as weights it *is* the measured material, bit for bit, whatever the mapping.

    Source: Hikichi & Iwasaki, eq. 13, written as weights of the measured materials.
    """

    def __init__(self, materials: Sequence[BRDF], weights: Array, mapping: Mapping):
        """Combine N materials of the same bands with weights v (N,) under a mapping T.

        Raises:
            ShapeError: there is not one finite weight per material.
            BandMismatchError: the materials have different bands.
        """
        weights = np.asarray(weights, dtype=np.float64)
        if weights.shape != (len(materials),) or not np.all(np.isfinite(weights)) or not np.any(weights):
            raise ShapeError(
                f"weights have shape {weights.shape}, expected ({len(materials)},), finite and not all zero"
            )
        used = np.flatnonzero(weights)
        self._weights = weights[used]
        self._mapping = mapping
        super().__init__([materials[int(k)] for k in used], np.abs(self._weights), materials[0].bands)

    def _measured(self) -> BRDF | None:
        """The material that this is, if it is one."""
        return self._materials[0] if len(self._materials) == 1 and self._weights[0] == 1.0 else None

    def eval(self, wi: Array, wo: Array) -> Array:
        """BRDF f in 1/sr, shape (..., B); arguments and errors as in `Mixture.eval`."""
        measured = self._measured()
        return super().eval(wi, wo) if measured is None else measured.eval(wi, wo)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, shape (..., B); arguments and errors as in `Mixture.eval`."""
        measured = self._measured()
        return super().eval_cos(wi, wo) if measured is None else measured.eval_cos(wi, wo)

    def _combine(self, pairs: DirectionPairs, out: Array) -> None:
        """Values of K direction pairs into out (K, B)."""
        cosines = cosine_weight(pairs.wi, pairs.wo)
        fused = isinstance(self._mapping, CubeRoot | Identity)
        out[...] = 0.0
        for weight, material in zip(self._weights, self._materials, strict=True):
            if not isinstance(material, MeasuredBRDF):
                out += weight * self._mapping.forward(material.eval(pairs.wi, pairs.wo), cosines)
            elif fused:
                is_root = isinstance(self._mapping, CubeRoot)
                material.add_weighted(pairs, float(weight), out, cube_root=is_root)
            else:
                f = np.empty_like(out)
                material.eval_into(pairs, f)
                out += weight * self._mapping.forward(f, cosines)
        out[...] = self._mapping.inverse(out, cosines)
        out[cosines <= 0] = 0.0


class MonochromePrediction(Mixture):
    """T^-1(sum_s V_bs T(f_s)): every band b a sum over monochrome samples, a few bands of each material.

    Source: docs/design/held-out.md.
    """

    def __init__(self, samples: Sequence[BRDF], weights: Array, mapping: Mapping, bands: Bands):
        """Combine N materials in the sample bands with weights V (B, N B_s) under a mapping T.

        Args:
            samples: the materials in their sample bands; sample n B_s + s is band s of material n.
            weights: shape (B, N B_s).
            mapping: T.
            bands: the B bands to predict.
        Raises:
            ShapeError: the weights do not fit, or are not finite.
            BandMismatchError: the materials have different bands.
        """
        weights = np.asarray(weights, dtype=np.float64)
        n_bands = samples[0].bands.count
        expected = (bands.count, len(samples) * n_bands)
        if weights.shape != expected or not np.all(np.isfinite(weights)):
            raise ShapeError(f"weights have shape {weights.shape}, expected {expected}, finite")
        self._mapping = mapping
        self._weights_T = np.ascontiguousarray(weights.T)
        sampling_weights = np.abs(weights).reshape(bands.count, len(samples), n_bands).sum(axis=(0, 2))
        super().__init__(samples, sampling_weights, bands)

    def _combine(self, pairs: DirectionPairs, out: Array) -> None:
        """Values of K direction pairs into out (K, B)."""
        cosines = cosine_weight(pairs.wi, pairs.wo)
        mapped = np.empty((len(self._materials), len(pairs), self._materials[0].bands.count))
        for material, values in zip(self._materials, mapped, strict=True):
            if not isinstance(material, MeasuredBRDF):
                values[...] = self._mapping.forward(material.eval(pairs.wi, pairs.wo), cosines)
            elif isinstance(self._mapping, CubeRoot):
                values[...] = 0.0
                material.add_weighted(pairs, 1.0, values, cube_root=True)
            else:
                material.eval_into(pairs, values)
                values[...] = self._mapping.forward(values, cosines)
        samples = np.moveaxis(mapped, 0, 1).reshape(len(pairs), -1)  # [K, N B_s]
        np.matmul(samples, self._weights_T, out=out)
        out[...] = self._mapping.inverse(out, cosines)
        out[cosines <= 0] = 0.0


class ClippedBRDF:
    """A BRDF with negative values cut to zero, as files must have them; counts what it cut."""

    def __init__(self, brdf: BRDF):
        """Wrap a BRDF."""
        self._brdf = brdf
        self._seen = 0
        self._cut = 0
        self.sample, self.pdf, self.albedo = brdf.sample, brdf.pdf, brdf.albedo

    @property
    def bands(self) -> Bands:
        """The spectral axis."""
        return self._brdf.bands

    @property
    def is_isotropic(self) -> bool:
        """Whether the BRDF is."""
        return self._brdf.is_isotropic

    @property
    def clipped_share(self) -> float:
        """Share of the values evaluated so far that were negative."""
        return self._cut / max(self._seen, 1)

    def eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, at least 0, shape (..., B); arguments and errors as in the wrapped BRDF."""
        f = self._brdf.eval(wi, wo)
        self._seen += f.size
        self._cut += int(np.count_nonzero(f < 0))
        return np.maximum(f, 0.0)

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """f * cos(theta_o) in 1/sr, at least 0, shape (..., B)."""
        return self.eval(wi, wo) * np.maximum(np.asarray(wo)[..., 2], 0.0)[..., None]
