"""The protocols that all BRDFs share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

import numpy as np

from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array, Bands

LEAST_RESOLUTION = 4
"""Smallest number of nodes per axis for the quadrature of an albedo; fewer nodes miss the lobe."""


class EvaluableBRDF(Protocol):
    """The interface of a BRDF that can be evaluated; fits, rendered balls and plots of slices need no more."""

    @property
    def bands(self) -> Bands:
        """Return the spectral bands, or the channels of linear sRGB."""

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); 0 for a direction that is not above the horizon.

        Measured values may be negative, because RGB files of the RGL database contain colours outside sRGB.
        """


@runtime_checkable
class BRDF(EvaluableBRDF, Protocol):
    """The interface of a BRDF that can be evaluated and sampled in B bands; directions are (..., 3), z is up."""

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
    """Return whether every BRDF is isotropic, so that direction pairs at one incident azimuth are enough."""
    return all(brdf.is_isotropic for brdf in brdfs)


def require_brdf(brdf: object, where: str) -> None:
    """Raise UsageError unless an object has the methods of `BRDF`; a `BsdfFile` or a path has none of them.

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
    """Return the values f (K, B) of a user's `eval` at K = `count` direction pairs, after checking them.

    Raises:
        ShapeError: f has another shape, or values that are not finite.
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
    """Raise UsageError unless a number of nodes per axis is an integer of at least `LEAST_RESOLUTION`."""
    if not isinstance(resolution, int | np.integer) or resolution < LEAST_RESOLUTION:
        raise UsageError(f"resolution is {resolution}, expected an integer of at least {LEAST_RESOLUTION}")
