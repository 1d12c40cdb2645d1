"""The measured BRDF of an RGL file."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from manifold.brdf.interface import EvaluableBRDF, require_resolution
from manifold.brdf.notebook import NotebookPicture
from manifold.brdf.warp import Warp
from manifold.core.compiled import loops
from manifold.core.directions import require_directions, rotate_z
from manifold.core.errors import ShapeError, UsageError
from manifold.core.pairs import Pairs, Symmetry, as_rows, results
from manifold.core.records import Array, BsdfFile
from manifold.core.threads import share_rows

_FEW = 512  # pairs of directions of a block: fewer take less time than starting a thread


def values_at(brdf: EvaluableBRDF, pairs: Pairs) -> Array:
    """Return f in 1/sr at K direction pairs, shape (K, B); a `MeasuredBRDF` uses coordinates cached in `pairs`."""
    return brdf.eval_at(pairs) if isinstance(brdf, MeasuredBRDF) else brdf.eval(pairs.wi, pairs.wo)


class MeasuredBRDF(NotebookPicture):
    """The BRDF of an RGL file, which evaluates all bands of a direction pair together.

    Attributes:
        name: name of the material.
        bands: the spectral bands.
        is_isotropic: whether the values depend only on the difference of the azimuths.
        symmetry: the arguments of `Pairs.located`: whether the material is isotropic, how often azimuths repeat,
            and the azimuth by which the specimen was turned.
        spectra: the stored values, single precision, shape (P * T, H, W, B).
        tables: arrays in the form that the compiled loops read.
    Source: Dupuy & Jakob 2018, section 5; f * cos(theta_o) = spectra * ndf / (4 sigma).
    """

    def __init__(self, file: BsdfFile):
        """Prepare a file for evaluation: normalise its warps and store its bands contiguously.

        Raises:
            UsageError: `file` is no `BsdfFile`, such as a path; `read_bsdf` reads a path.
        """
        if not isinstance(file, BsdfFile):
            raise UsageError(
                f"found {type(file).__name__}, expected a BsdfFile, as returned by read_bsdf(path)"
            )
        self.name = file.name
        self.bands = file.bands
        self.is_isotropic = file.is_isotropic
        repeats, rotation_rad = (1, 0.0) if self.is_isotropic else (file.azimuth_repeats, file.rotation_rad)
        self.symmetry: Symmetry = (self.is_isotropic, repeats, rotation_rad)
        self._stored_luminance = file.luminance
        self._axes = file.phi_i_rad, file.theta_i_rad
        self._vndf = file.vndf
        self._warp = Warp(self._vndf, *self._axes)
        band_last = np.moveaxis(file.spectra, 2, -1)  # (P, T, H, W, B)
        self.spectra = np.ascontiguousarray(band_last, np.float32).reshape(-1, *band_last.shape[2:])
        self._scale = bool(file.jacobian), file.ndf, file.sigma
        self.tables = self._tables()

    def _tables(self) -> loops.Tables:
        return loops.Tables(*self._scale, self._warp.tables, self.spectra)

    @cached_property
    def _luminance(self) -> Warp:
        """The density for sampling: the luminance, made positive, because RGB files have a few negative values."""
        density = np.maximum(self._stored_luminance, 0.0)  # [P, T, H, W]
        black = density.sum(axis=(2, 3), keepdims=True) <= 0
        return Warp(np.where(black, 1.0, density), *self._axes)

    def __copy__(self) -> MeasuredBRDF:
        """Return a copy that shares arrays and tables."""
        copied = object.__new__(type(self))
        vars(copied).update(vars(self))
        return copied

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels to other processes: arrays, from which `__setstate__` prepares the tables."""
        prepared = ("_warp", "tables", "_luminance")
        return {name: value for name, value in vars(self).items() if name not in prepared}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._warp = Warp(self._vndf, *self._axes)
        self.tables = self._tables()

    def __repr__(self) -> str:
        return f"MeasuredBRDF({self.name!r}, {self.bands})"

    def select_bands(self, bands: Sequence[int]) -> MeasuredBRDF:
        """Return the BRDF in some of its bands; the warps are shared.

        Args:
            bands: increasing band indices; an RGB material needs all three.

        Raises:
            UsageError: the indices do not increase, or an RGB material would lose a channel.
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
        """Return the BRDF turned about the normal by an azimuth in radians; the tables are shared.

        Raises:
            UsageError: the azimuth is not finite.
        """
        if not math.isfinite(angle_rad):
            raise UsageError(f"found an azimuth of {angle_rad}, expected radians")
        if self.is_isotropic:
            return self
        turned = copy.copy(self)
        turned.symmetry = (*self.symmetry[:2], self.symmetry[2] - angle_rad)
        return turned

    def _turn(self, w: Array, sign: float = 1.0) -> Array:
        """Rotate directions (K, 3) into the frame of the measured sample, or with sign -1 back."""
        rotation = sign * self.symmetry[2]
        return rotate_z(w, rotation) if rotation else w

    @staticmethod
    def _share(work: Callable[[slice, Array, Array], bool], count: int, wi: Array, others: Array) -> bool:
        """Call `work` with blocks of rows on several threads; return whether all directions are unit vectors."""
        are_units: list[bool] = []
        share_rows(
            lambda k: are_units.append(
                work(k, *(rows if len(rows) == 1 else rows[k] for rows in (wi, others)))
            ),
            count,
            _FEW,
        )
        return all(are_units)

    def _evaluate(self, wi: Array, wo: Array, divide: bool, out: Array | None) -> Array:
        flat_wi, flat_wo, shape = as_rows(wi, wo, "wo")
        out = results((*shape, self.bands.count), out, flat_wi.dtype, (flat_wi, flat_wo))
        rows = out.reshape(-1, self.bands.count)
        if not self._share(
            lambda k, i, o: loops.eval_pairs(i, o, *self.symmetry[:2], divide, self.tables, rows[k]),
            len(rows),
            self._turn(flat_wi),
            self._turn(flat_wo),
        ):
            require_directions(wi, "wi")
            require_directions(wo, "wo")
        return out

    def eval_at(self, pairs: Pairs) -> Array:
        """Return f in 1/sr at K direction pairs, shape (K, B), on one core and without the interpreter's lock.

        Callers that distribute materials or pairs over threads use this method.
        """
        out = np.empty((len(pairs), self.bands.count))
        loops.eval_located(pairs.located(*self.symmetry), self.tables, out)
        return out

    def eval(self, wi: Array, wo: Array, out: Array | None = None) -> Array:
        """Return f in 1/sr, shape (..., B); it is negative where the file is, for example for RGB colours outside sRGB.

        Args:
            wi, wo: unit vectors (..., 3) that broadcast against each other. If both are in single precision, so are
                the values.
            out: contiguous array (..., B) in double or single precision, which receives the values and is returned.
                Passing the same array in every call saves up to half of the time, because no new memory is
                allocated.

        Raises:
            ShapeError: a direction array is not (..., 3), not real, not finite, or not of unit length; `out` does not
                fit, or overlaps the directions.
        """
        return self._evaluate(wi, wo, True, out)

    def eval_cos(self, wi: Array, wo: Array, out: Array | None = None) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B); arguments and errors as in `eval`."""
        return self._evaluate(wi, wo, False, out)

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density of `sample` in 1/sr, shape (...); arguments and errors as in `eval`."""
        flat_wi, flat_wo, shape = as_rows(wi, wo, "wo")
        out, luminance = np.empty(math.prod(shape), flat_wi.dtype), self._luminance.tables
        if not self._share(
            lambda k, i, o: loops.pdf_of_pairs(i, o, *self.symmetry[:2], self.tables, luminance, out[k]),
            len(out),
            self._turn(flat_wi),
            self._turn(flat_wo),
        ):
            require_directions(wi, "wi")
            require_directions(wo, "wo")
        return out.reshape(shape)

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (..., 3) and their pdf (...) in 1/sr; pdf 0 marks an invalid sample.

        Args:
            wi: incident unit vectors (..., 3).
            u: uniform variates in [0, 1), shape (..., 2), that broadcast against wi.

        Raises:
            ShapeError: as in `eval`, or u is not (..., 2) in [0, 1].
        """
        flat_wi, flat_u, shape = as_rows(wi, u, "u", 2)
        if flat_u.size and not (flat_u.min() >= 0.0 and flat_u.max() <= 1.0):
            raise ShapeError("u has values outside [0, 1], expected uniform variates")
        count, luminance = math.prod(shape), self._luminance.tables
        wo, pdf = np.empty((count, 3), flat_wi.dtype), np.empty(count, flat_wi.dtype)
        if not self._share(
            lambda k, i, v: loops.sample_directions(
                i, v, *self.symmetry[:2], self.tables, luminance, wo[k], pdf[k]
            ),
            count,
            self._turn(flat_wi),
            flat_u,
        ):
            require_directions(wi, "wi")
        wo = self._turn(wo, -1.0).astype(pdf.dtype, copy=False)
        return wo.reshape(*shape, 3), pdf.reshape(shape)

    def albedo(self, wi: Array, resolution: int = 64) -> Array:
        """Return the directional albedo, shape (..., B), in double precision.

        The integral is computed by the midpoint rule on resolution^2 points of the warped unit square, where the
        integrand is smooth, because it is nearly the stored spectrum.

        Raises:
            ShapeError: as in `eval`.
            UsageError: the resolution is not an integer of at least 4.
        """
        require_resolution(resolution)
        wi = require_directions(wi, "wi")
        flat = np.ascontiguousarray(self._turn(wi).reshape(-1, 3))
        sums = np.empty((flat.shape[0], resolution, self.bands.count))
        share_rows(lambda k: loops.integrate(flat[k], *self.symmetry[:2], self.tables, sums[k]), len(flat), 1)
        return np.asarray((sums.sum(axis=1) / resolution**2).reshape(*wi.shape[:-1], sums.shape[2]))
