"""The protocols that all BRDFs share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands


class EvaluableBRDF(Protocol):
    """The part of a BRDF that fits, balls and slices use: B bands at once, directions (..., 3), z the normal."""

    @property
    def bands(self) -> Bands:
        """The spectral axis."""

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); 0 for a direction that is not above the horizon."""


@runtime_checkable
class BRDF(EvaluableBRDF, Protocol):
    """The interface of a BRDF."""

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
    """Raise UsageError unless something has what evaluating a `BRDF` takes: a file or a path has not.

    Args:
        brdf: given by a user.
        where: what it was given to.
    """
    missing = [name for name in ("bands", "is_isotropic", "eval", "eval_cos") if not hasattr(brdf, name)]
    if missing:
        raise UsageError(
            f"{where}: found {type(brdf).__name__}, without {', '.join(missing)}, expected a BRDF; a file becomes one "
            "by MeasuredBRDF(read_bsdf(path))"
        )
