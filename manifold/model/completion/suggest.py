"""Which directions to read next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.formats.readings import geometry_ma_t12
from manifold.model.completion.complete import Completion
from manifold.model.completion.samples import LibrarySamples
from manifold.models.next_readings import next_readings
from manifold.records import Array

_SAME_DEG = 2.0  # a reading this near in both directions was taken
_MINI_DIFF_INCIDENCES_DEG = (0, 20, 40, 60)
_MINI_DIFF_LARGEST_DEG = 75


@dataclass(frozen=True, eq=False)
class Suggested:
    """Directions to read, in this order.

    Attributes:
        wi, wo: unit vectors (K, 3).
    """

    wi: Array
    wo: Array

    @property
    def angles_deg(self) -> Array:
        """theta_i, theta_o and the azimuth between the mirror direction and wo, in degrees, shape (K, 3)."""
        theta = [np.degrees(np.arccos(np.clip(w[:, 2], -1.0, 1.0))) for w in (self.wi, self.wo)]
        phi = [np.degrees(np.arctan2(w[:, 1], w[:, 0])) for w in (self.wi, self.wo)]
        turned = np.abs((phi[1] - phi[0] - 180.0 + 180.0) % 360.0 - 180.0)
        return np.column_stack([*theta, turned])


def suggest(
    samples: LibrarySamples, count: int, known: Completion | None = None, instrument: str | None = None
) -> Suggested:
    """The directions that would lower the expected error most, one after the other.

    Args:
        samples: of the library.
        count: how many.
        known: what readings said already; None starts from nothing.
        instrument: whose directions to choose from, see `DIRECTIONS`; None for all.
    Raises:
        UsageError: there is no such instrument, or it has fewer directions left.
    """
    wi, wo = directions_of(instrument)
    if known is not None:
        is_new = ~_taken(wi, wo, known.readings.wi, known.readings.wo)
        wi, wo = wi[is_new], wo[is_new]
    if not 1 <= count <= len(wi):
        raise UsageError(f"{count} readings to suggest, expected 1 to {len(wi)}, as many as there are left")
    at = samples.at(wi, wo)
    if known is None:
        chosen = first_readings(samples, at, count)
    else:
        probability, weights = known.likeliest
        chosen = next_readings(
            weights @ samples.directions, weights @ at, probability, samples.weights, count
        )
    return Suggested(wi[chosen], wo[chosen])


def first_readings(samples: LibrarySamples, at: Array, count: int) -> Array:
    """Which candidates, at which samples have cube roots `at` (n + 1, D), to read first; every sample is as likely."""
    n = len(at) - 1
    return next_readings(samples.directions[:n], at[:n], np.full(n, 1.0 / n), samples.weights, count)


def all_directions() -> tuple[Array, Array]:
    """Elevations from 0 to 80 degrees by 10, azimuths by 30: wi (D, 3) and wo (D, 3)."""
    return _product(np.arange(0, 81, 10), np.arange(0, 81, 10), np.arange(0, 181, 30))


def _mini_diff() -> tuple[Array, Array]:
    return _product(
        np.array(_MINI_DIFF_INCIDENCES_DEG),
        np.arange(0, _MINI_DIFF_LARGEST_DEG + 1, 5),
        np.arange(0, 181, 10),
    )


DIRECTIONS = {"ma-t12": geometry_ma_t12, "mini-diff": _mini_diff}
"""What named instruments can read."""


def directions_of(instrument: str | None) -> tuple[Array, Array]:
    """Directions of a named instrument, or of any.

    Raises:
        UsageError: there is no such instrument.
    """
    if instrument is None:
        return all_directions()
    if instrument not in DIRECTIONS:
        raise UsageError(f"no instrument '{instrument}', expected one of {', '.join(DIRECTIONS)}")
    return DIRECTIONS[instrument]()


def _product(incidences_deg: Array, elevations_deg: Array, azimuths_deg: Array) -> tuple[Array, Array]:
    """Pairs of these angles; where a direction is the normal, one azimuth. wi has azimuth 180 degrees."""
    theta_i, theta_o, phi = (
        a.ravel() for a in np.meshgrid(incidences_deg, elevations_deg, azimuths_deg, indexing="ij")
    )
    is_one = (phi == azimuths_deg[0]) | ((theta_i != 0) & (theta_o != 0))
    theta_i, theta_o, phi = (np.deg2rad(a[is_one].astype(float)) for a in (theta_i, theta_o, phi))
    return from_spherical(theta_i, np.pi), from_spherical(theta_o, phi)


def _taken(wi: Array, wo: Array, read_wi: Array, read_wo: Array) -> Array:
    """Which pairs were read, or their reverses, up to a turn about the normal: bool (D,)."""

    def invariants(a: Array, b: Array) -> Array:
        return np.column_stack([a[:, 2], b[:, 2], np.sum(a * b, axis=1)])

    here = np.arccos(np.clip(invariants(wi, wo), -1.0, 1.0))
    limit = np.deg2rad(_SAME_DEG)
    taken = np.zeros(len(wi), bool)
    for a, b in ((read_wi, read_wo), (read_wo, read_wi)):
        there = np.arccos(np.clip(invariants(a, b), -1.0, 1.0))
        taken |= (np.abs(here[:, None] - there[None]) < limit).all(axis=2).any(axis=1)
    return taken
