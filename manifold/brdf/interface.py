"""The protocols that all BRDFs share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands


class EvaluableBRDF(Protocol):
    """The interface of BRDFs that can be evaluated, but not sampled, which fits, balls and slices need."""

    @property
    def bands(self) -> Bands:
        """The spectral bands, or the channels of linear sRGB."""

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); 0 for a direction that is not above the horizon."""


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
