"""Suggested directions of the next readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.colour import ball_colours
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.model.completion.complete import Completion
from manifold.model.completion.samples import LibrarySamples, ball_places
from manifold.models.nearby import places
from manifold.models.next_readings import colours, hypotheses, missed, next_readings
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
    """The directions that reduce the expected error most, chosen greedily.

    Args:
        samples: of the library.
        count: how many.
        known: the completion of the readings so far; None if there are none.
        instrument: name in `DIRECTIONS`, of which to choose directions; None for any.
    Raises:
        UsageError: there is no such instrument, or it has fewer directions left.
    """
    wi, wo = directions_left(count, None if known is None else known.readings, instrument)
    chosen = readings_to_take(samples, samples.at(wi, wo), places(wi, wo), count, known)
    return Suggested(wi[chosen], wo[chosen])


def directions_left(
    count: int, readings: Readings | None = None, instrument: str | None = None
) -> tuple[Array, Array]:
    """Directions of a named instrument, or of any, that are not among the readings: wi (D, 3) and wo (D, 3).

    Raises:
        UsageError: there is no such instrument, or there are fewer than `count`.
    """
    wi, wo = directions_of(instrument)
    total, whose = len(wi), f"the {len(wi)} directions" + (f" of {instrument}" if instrument else "")
    if readings is not None:
        is_read = readings.measured.any(axis=1)
        is_new = ~_taken(wi, wo, readings.wi[is_read], readings.wo[is_read])
        wi, wo = wi[is_new], wo[is_new]
    if not 1 <= count <= len(wi):
        read = "" if len(wi) == total else f" and {total - len(wi)} of them read"
        other = "; name another instrument" if instrument else ""
        raise UsageError(
            f"{count} readings to suggest of {whose}{read}, expected 1 to {len(wi)}{other}"
            if len(wi)
            else f"the readings have all {whose[4:]} already, so that none is left to suggest{other}"
        )
    return wi, wo


def readings_to_take(
    samples: LibrarySamples, at: Array, where: Array, count: int, known: Completion | None = None
) -> Array:
    """Indices of the candidates to read next, in order, shape (count,).

    Hypotheses are those of the completion so far; before the first reading they are the samples, equally probable. See
    `next_readings` for the three unknowns.

    Args:
        samples: of the library.
        at: cube roots of samples at the candidates, shape (n + 1, D).
        where: coordinates of the candidates, see `nearby.places`, shape (D, 3).
        count: how many.
        known: the completion of the readings so far.
    """
    n = len(at) - 1
    if known is None:
        probability, weights, taken = np.full(n, 1.0 / n), np.eye(n, n + 1), np.zeros((n + 1, 0))
        near = np.zeros((0, 3))
    else:
        held = known.hypotheses
        probability, weights = held.probability, held.weights
        taken, near = known.at_readings, known.nearby.readings
    structure = hypotheses(
        weights @ samples.directions[:, : samples.n_grid], _pixels(weights @ samples.ball), weights @ at,
        probability, samples.weights[: samples.n_grid],
    )  # fmt: skip
    of_mean = np.cbrt(_band_means(samples, samples.ball**3))
    colour = colours(
        _pixels(samples.ball[:n]) - _pixels(of_mean)[samples.material_of[:n]],
        _colour(samples, at), probability @ (weights @ at) ** 2,
        _colour(samples, taken), probability @ (weights @ taken) ** 2,
    )  # fmt: skip
    ball, mean = ball_colours.ball(), probability @ weights
    light = np.maximum(mean @ samples.ball, 0.0) ** 3 * ball.light
    rest = missed(
        where, near, np.sqrt(probability @ (weights @ at) ** 2), ball_places(), light, ball.starts,
        _pixels((mean @ samples.ball)[None])[0],
    )  # fmt: skip
    return next_readings((structure, colour, rest), count)


def _pixels(roots: Array) -> Array:
    """Cube roots of the light of every pixel of a ball, at most 1, from cube roots of f (h, P_b): shape (h, K)."""
    ball = ball_colours.ball()
    light = np.add.reduceat(np.maximum(roots, 0.0) ** 3 * ball.light, ball.starts, axis=1)
    return np.asarray(np.cbrt(np.minimum(light, 1.0)))


def _band_means(samples: LibrarySamples, values: Array) -> Array:
    """Values (n + 1, P) of samples, averaged over the bands of each material, shape (N, P)."""
    shape = len(samples.names), samples.per_material, values.shape[1]
    return np.asarray(values[:-1].reshape(shape).mean(axis=1))


def _colour(samples: LibrarySamples, roots: Array) -> Array:
    """Cube roots of samples (n + 1, P), less those of the mean over the bands of their material, shape (n, P)."""
    means = np.cbrt(_band_means(samples, roots**3))
    return np.asarray(roots[:-1] - means[samples.material_of[:-1]])


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
"""Directions of named instruments."""


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
