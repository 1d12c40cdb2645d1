"""The measured BRDF of an RGL file."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.brdf.notebook import NotebookPicture
from manifold.brdf.warp import Warp
from manifold.core.compiled import loops
from manifold.core.directions import require_directions, rotate_z
from manifold.core.errors import UsageError
from manifold.core.pairs import Pairs, Symmetry, flat_samples
from manifold.core.records import Array, BsdfFile
from manifold.core.threads import share_rows

_FEW = 512  # pairs of directions of a block: fewer take less time than starting a thread


def values_at(brdf: EvaluableBRDF, pairs: Pairs) -> Array:
    """Return f in 1/sr at K pairs, shape (K, B); measured materials share the pairs' locations in their files."""
    return brdf.eval_at(pairs) if isinstance(brdf, MeasuredBRDF) else brdf.eval(pairs.wi, pairs.wo)


class MeasuredBRDF(NotebookPicture):
    """The BRDF of an RGL file, all bands of a direction pair from one warp inversion.

    Attributes:
        name: of the material.
        bands: the spectral axis.
        is_isotropic: whether the file depends on the difference of the azimuths only.
        symmetry: the arguments of `Pairs.located`: whether it is isotropic, how often azimuths repeat, and
            the azimuth by which the sample lay turned.
        spectra: the stored values, single precision, shape (P * T, H, W, B).
        tables: what compiled loops read.
    Source: Dupuy & Jakob 2018, section 5; f * cos(theta_o) = spectra * ndf / (4 sigma).
    """

    def __init__(self, file: BsdfFile):
        """Normalise the warps of `file` and lay its bands out contiguously (a copy only where needed).

        Raises:
            UsageError: `file` is something else, such as a path, which `read_bsdf` reads.
        """
        if not isinstance(file, BsdfFile):
            raise UsageError(f"found {type(file).__name__}, expected a file that was read: read_bsdf(path)")
        self.name = file.name
        self.bands = file.bands
        self.is_isotropic = file.is_isotropic
        repeats, rotation_rad = (1, 0.0) if self.is_isotropic else (file.azimuth_repeats, file.rotation_rad)
        self.symmetry: Symmetry = (self.is_isotropic, repeats, rotation_rad)
        self._stored_luminance = file.luminance
        self._warp = Warp.from_values(file.vndf, file.phi_i_rad, file.theta_i_rad)
        band_last = np.moveaxis(file.spectra, 2, -1)  # (P, T, H, W, B)
        self.spectra = np.ascontiguousarray(band_last, np.float32).reshape(-1, *band_last.shape[2:])
        self._scale = (bool(file.jacobian), np.asarray(file.ndf, float), np.asarray(file.sigma, float))
        self.tables = self._tables()

    def _tables(self) -> loops.Tables:
        warp = self._warp
        return loops.Tables(
            *self._scale,
            warp.data,
            warp.conditional,
            warp.marginal,
            warp.phi_nodes,
            warp.theta_nodes,
            self.spectra,
        )

    @cached_property
    def _luminance(self) -> Warp:
        """The density that is sampled: RGB files have a few values just below zero, black ones only zeros."""
        density = np.maximum(self._stored_luminance, 0.0)  # [P, T, H, W]
        black = density.sum(axis=(2, 3), keepdims=True) <= 0
        return Warp.from_values(np.where(black, 1.0, density), self._warp.phi_nodes, self._warp.theta_nodes)

    def __repr__(self) -> str:
        return f"MeasuredBRDF({self.name!r}, {self.bands})"

    def select_bands(self, bands: Sequence[int]) -> MeasuredBRDF:
        """Return the material in some of its bands; warps are shared.

        Args:
            bands: indices, increasing. All three of an RGB material, or any of a spectral one.

        Raises:
            UsageError: a spectral axis cannot be made of these.
        """
        if list(bands) == list(range(self.bands.count)):
            return self
        if self.bands.is_rgb:
            raise UsageError(f"bands {list(bands)} of an RGB material, expected all three")
        selected = copy.copy(self)
        selected.bands = self.bands.select(bands)
        selected.spectra = np.ascontiguousarray(self.spectra[..., list(bands)])
        selected.tables = selected._tables()
        return selected

    def turned(self, angle_rad: float) -> MeasuredBRDF:
        """Return the sample turned by an azimuth; tables are shared."""
        if self.is_isotropic:
            return self
        turned = copy.copy(self)
        turned.symmetry = (*self.symmetry[:2], self.symmetry[2] - angle_rad)
        return turned

    def _evaluate(self, wi: Array, wo: Array, divide: bool, out: Array | None) -> Array:
        pairs = Pairs(wi, wo)
        out = pairs.results(self.bands.count, out)
        isotropic, repeats, rotation = self.symmetry
        rows = out.reshape(len(pairs), self.bands.count)
        flat_wi, flat_wo = pairs.turned(rotation)
        share_rows(
            lambda k: loops.eval_pairs(
                flat_wi[k], flat_wo[k], isotropic, repeats, divide, self.tables, rows[k]
            ),
            len(pairs),
            _FEW,
        )
        return out

    def eval_at(self, pairs: Pairs) -> Array:
        """Return `eval` at K pairs, shape (K, B), on one core and outside the interpreter's lock.

        For callers that distribute materials or blocks of pairs over threads.
        """
        out = np.empty((len(pairs), self.bands.count))
        loops.eval_located(pairs.located(*self.symmetry), True, self.tables, out)
        return out

    def eval(self, wi: Array, wo: Array, out: Array | None = None) -> Array:
        """Return f in 1/sr, shape (..., B).

        Args:
            wi, wo: unit vectors (..., 3) that broadcast against each other.
            out: receives the values and is returned: contiguous (..., B), double or single precision. Used again from
                call to call, it saves up to half of the time: the system need not find new memory.

        Raises:
            ShapeError: a direction array is not (..., 3), not finite, or not of unit length; `out` does not fit.
        """
        return self._evaluate(wi, wo, True, out)

    def eval_cos(self, wi: Array, wo: Array, out: Array | None = None) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B); arguments and errors as in `eval`."""
        return self._evaluate(wi, wo, False, out)

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr, shape (...); arguments and errors as in `eval`."""
        pairs = Pairs(wi, wo)
        out = np.empty(len(pairs))
        isotropic, repeats, rotation = self.symmetry
        density, (flat_wi, flat_wo) = self._luminance.data, pairs.turned(rotation)
        share_rows(
            lambda k: loops.pdf_of_pairs(
                flat_wi[k], flat_wo[k], isotropic, repeats, self.tables, density, out[k]
            ),
            len(out),
            _FEW,
        )
        return out.reshape(pairs.shape)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (..., 3) and their pdf (...) in 1/sr; pdf 0 marks an invalid sample.

        Args:
            wi: incident unit vectors (..., 3).
            u: uniform variates in [0, 1), shape (..., 2), that broadcast against wi.

        Raises:
            ShapeError: as in `eval`, or u is not (..., 2) in [0, 1].
        """
        flat_wi, flat_u, shape = flat_samples(wi, u)
        isotropic, repeats, rotation = self.symmetry
        flat_wi = rotate_z(flat_wi, rotation) if rotation else flat_wi
        wo = np.empty_like(flat_wi)
        pdf = np.empty(flat_wi.shape[0])
        warp = self._luminance
        luminance = (warp.data, warp.conditional, warp.marginal)
        share_rows(
            lambda k: loops.sample_directions(
                flat_wi[k], flat_u[k], isotropic, repeats, self.tables, *luminance, wo[k], pdf[k]
            ),
            len(pdf),
            _FEW,
        )
        wo = rotate_z(wo, -rotation) if rotation else wo
        return wo.reshape(*shape, 3), pdf.reshape(shape)

    def albedo(self, wi: Array, resolution: int = 64) -> Array:
        """Return the directional albedo, shape (..., B).

        It is computed by the midpoint rule on resolution^2 points of the warped square.

        There f * cos(theta_o) / pdf of the visible normals is nearly the smooth stored spectrum.

        Raises:
            ShapeError: as in `eval`.
        """
        wi = require_directions(wi, "wi")
        isotropic, repeats, rotation = self.symmetry
        flat = np.ascontiguousarray(rotate_z(wi, rotation).reshape(-1, 3))
        sums = np.empty((flat.shape[0], resolution, self.bands.count))
        share_rows(lambda k: loops.integrate(flat[k], isotropic, repeats, self.tables, sums[k]), len(flat), 1)
        return np.asarray((sums.sum(axis=1) / resolution**2).reshape(*wi.shape[:-1], sums.shape[2]))
