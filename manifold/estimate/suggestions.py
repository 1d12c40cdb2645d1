"""Suggests the directions of the next readings: those that reduce the uncertainty of the completed BRDF most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import solve_triangular

from manifold.colour import panel
from manifold.core.defaults import MINI_DIFF_SEES_DEG, RIDGE
from manifold.core.directions import angles_from_mirror, from_spherical
from manifold.core.errors import UsageError
from manifold.core.records import Array, Indices, Mask
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.estimate.mixtures import NOISE as READING_NOISE
from manifold.estimate.mixtures import material_prior
from manifold.estimate.residual import DARK, NOISE, coordinates, covariance
from manifold.formats.light_side import LEAST_HIDDEN
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.library.store import Library
from manifold.registries import Registry

_BALL = 3.0  # weight of the ball against all directions
_LEAST = 1e-4  # added to the standard deviation of every pixel


@dataclass(frozen=True, eq=False)
class Deviations:
    """H equally probable deviations of the true material from a completion, with mean zero.

    Attributes:
        at_candidates: deviations of cube roots at the candidate readings, shape (H, D).
        on_ball: deviations of the pixels of a ball, shape (H, K).
        everywhere: deviations at all directions, times the square roots of their weights, shape (H, P); P may be 0.
        noise: variance of the noise of the candidates, shape (D,).
    """

    at_candidates: Array
    on_ball: Array
    everywhere: Array
    noise: Array

    def variance_reduction(self, wanted: Array) -> Array:
        """Return the variance reduction (D, W) of W values by each candidate, given their deviations (H, W)."""
        variance = np.sum(self.at_candidates**2, axis=0) + self.noise
        # A black completion deviates by nothing.
        return np.asarray((self.at_candidates.T @ wanted) ** 2 / (variance + np.finfo(float).tiny)[:, None])

    def after(self, reading: Array, noise: float) -> Deviations:
        """Return the deviations after a reading, given its noise variance and the deviations (H,) at its directions."""
        variance = float(reading @ reading)
        if variance == 0.0:
            return self
        # (I - k r r^T) C, with k such that the covariance becomes the posterior one.
        k = (1.0 - np.sqrt(noise / (variance + noise))) / variance
        tables = (self.at_candidates, self.on_ball, self.everywhere)
        left = [table - k * np.outer(reading, reading @ table) for table in tables]
        return Deviations(left[0], left[1], left[2], self.noise)


def next_readings(unknowns: Sequence[Deviations], count: int) -> Indices:
    """Return the indices (count,) of the candidates whose readings reduce the uncertainty most, chosen greedily.

    Each choice minimises s b^3, where s is the root mean square of the standard deviation over all directions, and b
    its mean over the pixels of a ball. The `unknowns` are independent of each other and have the same D candidates.
    """
    left = list(unknowns)
    chosen: list[int] = []
    for _ in range(count):
        # The logarithm of the product of both errors after each reading, shape (D,).
        all_variance = sum(
            np.sum(u.everywhere**2) - u.variance_reduction(u.everywhere).sum(axis=1) for u in left
        )
        on_ball = sum(np.sum(u.on_ball**2, axis=0) - u.variance_reduction(u.on_ball) for u in left)
        deviation = np.sqrt(np.maximum(on_ball, 0.0)) + _LEAST  # [D, K]
        all_variance = np.maximum(all_variance, np.finfo(float).tiny)
        cost = np.asarray(0.5 * np.log(all_variance) + _BALL * np.log(deviation.mean(axis=1)))
        cost[chosen] = np.inf
        best = int(np.argmin(cost))
        chosen.append(best)
        left = [u.after(u.at_candidates[:, best], float(u.noise[best])) for u in left]
    return np.array(chosen, dtype=np.intp)


_SAME_DEG = 2.0  # a reading this near in both directions was taken
_MINI_DIFF_INCIDENCES_DEG = (0, 20, 40, 60)
_COLOUR_NOISE = 0.05  # deviation of a band from the mean of all, as a share of the reading's cube root
_MODEL_ERROR = 0.1  # standard deviation of the residual of all hypotheses, relative to cube roots


@dataclass(frozen=True, eq=False)
class Suggested:
    """Directions of the next readings, in order, as unit vectors (K, 3)."""

    wi: Array
    wo: Array

    @property
    def angles_deg(self) -> Array:
        """theta_i, theta_o and the azimuth of wo from the mirror direction, in degrees, shape (K, 3)."""
        return angles_from_mirror(self.wi, self.wo)


def suggest(
    library: LibraryAtoms | Path, count: int, known: Completion | None = None, instrument: str | None = None
) -> Suggested:
    """Return the directions whose readings reduce the uncertainty of the completed BRDF most, chosen greedily.

    Args:
        library: path of a library of measured materials, or its atoms.
        count: number of directions.
        known: the completion of the readings so far; None if there are no readings.
        instrument: key of `DIRECTIONS` whose directions are the candidates; None allows any direction.

    Raises:
        UsageError: there is no such instrument, or it has fewer directions left.
    """
    wi, wo = directions_left(count, None if known is None else known.readings, instrument)
    atoms = library if isinstance(library, LibraryAtoms) else LibraryAtoms.of_library(Library(library))
    chosen = readings_to_take(atoms, atoms.at(wi, wo), coordinates(wi, wo), count, known)
    return Suggested(wi[chosen], wo[chosen])


def directions_left(count: int, readings: Readings | None, instrument: str | None) -> tuple[Array, Array]:
    """Return directions wi and wo (D, 3) that were not yet measured, of an instrument or of `all_directions`."""
    wi, wo = all_directions() if instrument is None else DIRECTIONS[instrument]()
    total, of = len(wi), f" of {instrument}" if instrument else ""
    if readings is not None:
        is_read = readings.measured.any(axis=1)
        is_new = ~_are_read(wi, wo, readings.wi[is_read], readings.wo[is_read])
        wi, wo = wi[is_new], wo[is_new]
    if count > len(wi):
        raise UsageError(
            f"{count} readings to suggest, but only {len(wi)} of {total} directions{of} are left"
        )
    return wi, wo


def readings_to_take(
    atoms: LibraryAtoms, at: Array, where: Array, count: int, known: Completion | None = None
) -> Indices:
    """Return the indices (count,) of the candidates to measure next, in order.

    The hypotheses are those of the completion `known`; before the first reading, all atoms are equally probable. `at`
    holds the cube roots of the atoms at the candidates (n + 1, D), `where` the candidates' coordinates (D, 3), see
    `residual.coordinates`.
    """
    n, lights = len(at) - 1, panel.fitted_pixels()
    on_ball = atoms.at(lights.wi, lights.wo)
    if known is None:
        N = len(atoms.materials)
        probability: Array = np.repeat(material_prior(N, len(atoms.names)), n // N) / (n // N)
        weights: Array = np.eye(n, n + 1)
        taken: Array = np.zeros((n + 1, 0))
        centres: Array = np.zeros((0, 3))
    else:
        (of,), factors, (_, taken, _) = known.solution.hypotheses, known.factors, known.evidence.read
        assert factors is not None
        probability, weights, centres = of.probability, of.weights, factors.centres
    square = probability @ (weights @ at) ** 2
    return next_readings(
        (
            _structure(atoms, weights, probability, at, on_ball),
            _colours(atoms, at, on_ball, square, taken, probability @ (weights @ taken) ** 2),
            _residual(where, centres, np.sqrt(square), (probability @ weights) @ on_ball),
        ),
        count,
    )


def _structure(
    atoms: LibraryAtoms, weights: Array, probability: Array, at: Array, on_ball: Array
) -> Deviations:
    """Return deviations of hypotheses with weights (H, n + 1) from their mean."""
    root = np.sqrt(probability)[:, None]
    on_grid = weights @ atoms.directions[:, : atoms.n_grid] * np.sqrt(atoms.weights[: atoms.n_grid])
    candidates = weights @ at
    at_candidates, pixels, everywhere = (
        root * (table - probability @ table) for table in (candidates, _pixels(weights @ on_ball), on_grid)
    )
    return Deviations(at_candidates, pixels, everywhere, _noise(probability @ candidates**2, READING_NOISE))


def _colours(
    atoms: LibraryAtoms, at: Array, on_ball: Array, square: Array, taken: Array, taken_square: Array
) -> Deviations:
    """Return deviations of bands from the mean over the bands of their material, given the T readings taken.

    `at`, `on_ball` and `taken` are cube roots of the atoms at the candidates (n + 1, D), at the direction pairs that
    light a ball (n + 1, P_b), and at the readings (n + 1, T). `square` (D,) and `taken_square` (T,) are the expected
    squares of the material's cube roots at the candidates and at the readings.
    """
    n, D = atoms.n_measured, at.shape[1]
    root = 1.0 / np.sqrt(n)
    deviations = Deviations(
        np.hstack([root * (roots - _mean_roots(atoms, roots)) for roots in (at[:n], taken[:n])]),
        root * (_pixels(on_ball[:n]) - _pixels(_mean_roots(atoms, on_ball[:n]))),
        np.zeros((n, 0)),
        _noise(np.append(square, taken_square), _COLOUR_NOISE),
    )
    for d in range(D, D + taken.shape[1]):
        deviations = deviations.after(deviations.at_candidates[:, d], float(deviations.noise[d]))
    return replace(deviations, at_candidates=deviations.at_candidates[:, :D], noise=deviations.noise[:D])


def _residual(where: Array, taken: Array, level: Array, mean_on_ball: Array) -> Deviations:
    """Return residuals of all hypotheses, relative to cube roots and correlated as in `residual`, given the readings.

    Candidates have coordinates (D, 3), readings (T, 3); expected cube roots are `level` (D,), and (P_b,) at pairs that
    light a ball.
    """
    lights, f = panel.fitted_pixels(), np.maximum(mean_on_ball, 0.0) ** 3
    on_ball = coordinates(lights.wi, lights.wo)
    total = np.maximum(lights.of(f), np.finfo(float).tiny)

    def with_pixels(of: Array) -> Array:
        return np.asarray(lights.of((covariance(of, on_ball) * f).T).T / total)

    own, of_pixels = covariance(where, where), with_pixels(where)
    if len(taken):
        between = covariance(where, taken)
        gain = np.linalg.solve(covariance(taken, taken) + NOISE * np.eye(len(taken)), between.T).T
        own, of_pixels = own - gain @ between.T, of_pixels - gain @ with_pixels(taken)
    L = np.linalg.cholesky(own + RIDGE * np.eye(len(own)))
    pixels = solve_triangular(L, of_pixels, lower=True)
    return Deviations(
        _MODEL_ERROR * L.T * level,
        _MODEL_ERROR * pixels * _pixels(mean_on_ball[None])[0],
        np.zeros((len(L), 0)),
        NOISE * (_MODEL_ERROR * level) ** 2,
    )


def _noise(square: Array, share: float) -> Array:
    """Return the variance of the noise of cube roots whose expected squares are (D,)."""
    return np.asarray(share**2 * (square + DARK**2 * square.mean()))


def _pixels(roots: Array) -> Array:
    """Return cube roots of the light of every pixel of a ball, at most 1, from cube roots of f (h, P_b): (h, K)."""
    return np.asarray(np.cbrt(np.minimum(panel.fitted_pixels().of(np.maximum(roots, 0.0).T ** 3).T, 1.0)))


def _mean_roots(atoms: LibraryAtoms, roots: Array) -> Array:
    """Return cube roots of the mean over the bands of each atom's material, from those of measured atoms (n, P)."""
    shape = len(atoms.names), len(atoms.atom_bands), roots.shape[1]
    return np.asarray(np.cbrt((roots**3).reshape(shape).mean(axis=1)).repeat(shape[1], axis=0))


def all_directions() -> tuple[Array, Array]:
    """Return direction pairs wi (D, 3), wo (D, 3) with polar angles 0, 10, ... 80 and azimuths 0, 30, ... degrees."""
    return _product(np.arange(0, 81, 10), np.arange(0, 81, 10), np.arange(0, 181, 30))


def _mini_diff() -> tuple[Array, Array]:
    return _product(
        np.array(_MINI_DIFF_INCIDENCES_DEG),
        np.arange(0, int(MINI_DIFF_SEES_DEG) + 1, 5),
        np.arange(0, 181, 10),
    )


DIRECTIONS = Registry("instrument", [("ma-t12", geometry_ma_t12), ("mini-diff", _mini_diff)])
"""Measurement directions of instruments, by name."""


def _product(incidences_deg: Indices, elevations_deg: Indices, azimuths_deg: Indices) -> tuple[Array, Array]:
    """Return pairs of these angles that a receiver does not hide; pairs with the normal have one azimuth.

    wi has an azimuth of 180 degrees.
    """
    theta_i, theta_o, phi = (
        a.ravel() for a in np.meshgrid(incidences_deg, elevations_deg, azimuths_deg, indexing="ij")
    )
    is_one = (phi == azimuths_deg[0]) | ((theta_i != 0) & (theta_o != 0))
    theta_i, theta_o, phi = (np.deg2rad(a[is_one].astype(float)) for a in (theta_i, theta_o, phi))
    wi, wo = from_spherical(theta_i, np.pi), from_spherical(theta_o, phi)
    is_seen = np.einsum("di,di->d", wi, wo) < LEAST_HIDDEN
    return wi[is_seen], wo[is_seen]


def _are_read(wi: Array, wo: Array, read_wi: Array, read_wo: Array) -> Mask:
    """Return a mask of pairs that were read, or their reverses, up to a turn about the normal: bool (D,)."""

    def invariants(a: Array, b: Array) -> Array:
        return np.column_stack([a[:, 2], b[:, 2], np.sum(a * b, axis=1)])

    here = np.arccos(np.clip(invariants(wi, wo), -1.0, 1.0))
    limit = np.deg2rad(_SAME_DEG)
    taken = np.zeros(len(wi), bool)
    for a, b in ((read_wi, read_wo), (read_wo, read_wi)):
        there = np.arccos(np.clip(invariants(a, b), -1.0, 1.0))
        taken |= (np.abs(here[:, None] - there[None]) < limit).all(axis=2).any(axis=1)
    return taken
