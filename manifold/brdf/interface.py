"""The protocols that all BRDFs share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

import numpy as np

from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array, Bands

LEAST_RESOLUTION = 4
"""Nodes per axis of an albedo's quadrature; fewer miss the lobe."""


class EvaluableBRDF(Protocol):
    """The interface of BRDFs that can be evaluated, but not sampled, which fits, balls and slices need."""

    @property
    def bands(self) -> Bands:
        """The spectral bands, or the channels of linear sRGB."""

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); 0 for a direction that is not above the horizon.

        Measured values may be negative: files of the RGL database in RGB hold colours outside sRGB.
        """


@runtime_checkable
class BRDF(EvaluableBRDF, Protocol):
    """The interface of a BRDF: evaluation and sampling of all B bands at directions (..., 3); z is the normal."""

    def eval_cos(self, wi: Array, wo: Array) -> Array:
        """Return f * cos(theta_o) in 1/sr, shape (..., B), like Mitsuba's `eval`."""

    def sample(self, wi: Array, u: Array) -> tuple[Array, Array]:
        """Return outgoing directions (..., 3) for uniform variates (..., 2), and their pdf (...) in 1/sr.

        A pdf of 0 marks an invalid sample.
        """

    def pdf(self, wi: Array, wo: Array) -> Array:
        """Return the density in 1/sr with which `sample` returns wo, shape (...)."""

    def albedo(self, wi: Array) -> Array:
        """Return the directional albedo, the integral of f * cos(theta_o) over outgoing directions, shape (..., B)."""


def all_isotropic(brdfs: Iterable[BRDF]) -> bool:
    """Return whether every BRDF is isotropic, so that direction pairs of one azimuth determine all of them."""
    return all(brdf.is_isotropic for brdf in brdfs)


def require_brdf(brdf: object, where: str) -> None:
    """Raise UsageError unless an object has the methods of `BRDF`; a file or a path has not.

    Args:
        brdf: the object that a user gave.
        where: the function or argument to which it was given, for the message.
    """
    missing = [name for name in ("bands", "is_isotropic", "eval", "eval_cos") if not hasattr(brdf, name)]
    if missing:
        raise UsageError(
            f"{where}: found {type(brdf).__name__}, without {', '.join(missing)}, expected a BRDF; a file becomes one "
            "by MeasuredBRDF(read_bsdf(path))"
        )


def require_values(f: Array, count: int, bands: Bands, where: str) -> Array:
    """Return f, (K, B), as a user's `eval` returned it at K = `count` direction pairs.

    Raises:
        ShapeError: it has another shape, or values that are not finite.
    """
    f, expected = np.asarray(f), (count, bands.count)
    if f.shape != expected:
        raise ShapeError(
            f"{where}: eval returns shape {f.shape}, expected {expected}: one row per direction pair, {bands}"
        )
    if bad := int(np.count_nonzero(~np.isfinite(f))):
        raise ShapeError(f"{where}: {bad} of {f.size} values of eval are not finite, expected f in 1/sr")
    return f


def require_resolution(resolution: int) -> None:
    """Raise UsageError unless a number of quadrature nodes per axis is an integer of at least `LEAST_RESOLUTION`."""
    if not isinstance(resolution, int | np.integer) or resolution < LEAST_RESOLUTION:
        raise UsageError(f"resolution is {resolution}, expected an integer of at least {LEAST_RESOLUTION}")
