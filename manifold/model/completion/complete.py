"""Completion of readings: the posterior over mixtures of samples, and its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from manifold.brdf.gloss import gloss_meter, gloss_units
from manifold.colour.conversion import luminance
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.formats.readings import Readings
from manifold.metrics import cosine_weight
from manifold.model.completion.corrected import CorrectedBRDF
from manifold.model.completion.reading_bands import beyond, for_library, in_all_bands
from manifold.model.completion.samples import LibrarySamples, ball_places, grid_places
from manifold.models.band_mixtures import BandMixtures, band_mixtures
from manifold.models.completion_weights import completion_weights
from manifold.models.gloss_readings import GlossReadings
from manifold.models.mixtures import posterior
from manifold.models.nearby import NearbyFactors, nearby_factors, places
from manifold.records import Array

_SHOWN_ALTERNATIVES = 5
_SEES_MIRRORS_DEG = 5.0  # from a mirror direction: readings this near measure all but the sharpest highlights
_DARK = 0.1  # of the mean over readings: errors of darker ones are relative to this
_ALIKE = 0.1  # relative difference on a ball below which two mixtures are one alternative


@dataclass(frozen=True)
class Alternative:
    """A mixture of materials that explains the readings.

    Attributes:
        like: names of its materials, and their weights.
        probability: of it and of mixtures that look alike.
        misfit: relative error of its mean over bands at the readings, before it is adjusted to them.
        difference: relative difference from the completion, in cube roots on the ball.
    """

    like: tuple[tuple[str, float], ...]
    probability: float
    misfit: float
    difference: float


@dataclass(frozen=True, eq=False)
class Completion:
    """A material completed from readings.

    Attributes:
        samples: of the library.
        readings: in the bands that were compared.
        at_readings: cube roots of samples there, shape (n + 1, P).
        hypotheses: mixtures of materials, and their probabilities.
        weights: of samples in the bands of the library, shape (B, n + 1).
        nearby: factors near the readings, in the bands of the library.
        predicted: f at the readings, in 1/sr, shape (P, B_r).
    """

    samples: LibrarySamples
    readings: Readings
    at_readings: Array
    hypotheses: BandMixtures
    weights: Array
    nearby: NearbyFactors
    predicted: Array

    @cached_property
    def brdf(self) -> CorrectedBRDF:
        """The completed BRDF, never negative."""
        return CorrectedBRDF(self.samples.predicted(self.weights), self.nearby)

    @cached_property
    def on_grid(self) -> Array:
        """f at the encoding grid, shape (P_g, B)."""
        return self._at(self.samples.directions[:, : self.samples.n_grid], grid_places())

    @cached_property
    def on_ball(self) -> Array:
        """f at all pairs that light a ball, shape (P_b, B)."""
        return self._at(self.samples.ball, ball_places())

    def _at(self, roots: Array, where: Array) -> Array:
        """f where samples have cube roots (n + 1, P), at places (P, 3)."""
        return np.asarray((self.weights @ roots * self.nearby.at(where)).T ** 3)

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions about the file, and bands and directions without readings, in sentences."""
        notes = list(self.readings.notes)
        reach = beyond(self.readings, self.samples.bands)
        if reach is not None and reach[0] == reach[1]:
            notes.append(
                f"read at {reach[0]:g} nm only, which tells no colour: the result is the same in all bands, and the "
                f"expected errors are those of coloured materials taken as grey"
            )
        elif reach is not None:
            notes.append(
                f"extrapolated below {reach[0]:g} nm and above {reach[1]:g} nm with the weights at these bands"
            )
        wi, wo = self.readings.wi, self.readings.wo
        from_mirror = np.rad2deg(np.arccos(np.clip(np.sum(wi * wo * [-1.0, -1.0, 1.0], axis=1), -1.0, 1.0)))
        if from_mirror.min() > _SEES_MIRRORS_DEG and not self.readings.gloss:
            notes.append(
                f"no reading within {from_mirror.min():.0f} degrees of a mirror direction: sharper highlights, "
                f"such as those of mirrors and clear coats, are not measured, and expected errors do not include "
                f"them; give their gloss (--gloss), or measure such a direction"
            )
        return tuple(notes)

    @cached_property
    def gloss(self) -> dict[float, float]:
        """Gloss units of the completion, at the angles in degrees at which gloss was read."""
        return gloss_units(self.brdf, self.readings.gloss)

    @cached_property
    def misfits(self) -> Array:
        """Relative error of cube roots at every reading over its bands, of dark ones to a tenth of the mean, (P,)."""
        is_read = self.readings.measured
        read = np.cbrt(np.maximum(np.where(is_read, self.readings.values, 0.0), 0.0))
        wrong = np.where(is_read, np.cbrt(self.predicted) - read, 0.0)
        norm = np.linalg.norm(read, axis=1)
        return np.linalg.norm(wrong, axis=1) / np.maximum(norm, _DARK * norm.mean())

    @cached_property
    def spread(self) -> float:
        """Standard deviation of hypotheses over all directions and the ball, relative to their mean, in cube roots."""
        probability, weights = self.hypotheses.probability, self.hypotheses.weights
        curves = weights @ self.samples.directions
        mean = probability @ curves
        variance = probability @ ((curves - mean) ** 2 @ self.samples.weights)
        return float(np.sqrt(variance / (mean**2 @ self.samples.weights)))

    def spread_at(self, wi: Array, wo: Array) -> Array:
        """Standard deviation of hypotheses about f at direction pairs (P, 3), relative to their mean, shape (P,)."""
        probability, weights = self.hypotheses.probability, self.hypotheses.weights
        curves = (weights @ self.samples.at(wi, wo)) ** 3
        mean = probability @ curves
        variance = probability @ (curves - mean) ** 2
        return np.sqrt(variance) / np.maximum(mean, np.finfo(float).tiny)

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Hypotheses that look different from each other on the ball, most probable first."""
        probability, weights = self.hypotheses.probability, self.hypotheses.weights
        on_ball = slice(self.samples.n_grid, None)
        curves = weights @ self.samples.directions[:, on_ball]
        importance = self.samples.weights[on_ball]
        mean = probability @ curves
        norm = float(mean**2 @ importance)
        heads: list[int] = []
        totals: list[float] = []
        for h, curve in enumerate(curves):
            apart = [float((curve - curves[k]) ** 2 @ importance) / norm for k in heads]
            if apart and min(apart) < _ALIKE**2:
                totals[int(np.argmin(apart))] += float(probability[h])
            else:
                heads.append(h)
                totals.append(float(probability[h]))
        order = np.argsort(totals)[::-1][:_SHOWN_ALTERNATIVES]
        structure = _structure(self.readings)
        return tuple(
            Alternative(
                self._materials(weights[heads[k]]),
                totals[k],
                float(np.linalg.norm(weights[heads[k]] @ self.at_readings - structure) / np.linalg.norm(structure)),
                float(np.sqrt((curves[heads[k]] - mean) ** 2 @ importance / norm)),
            )
            for k in order
        )  # fmt: skip

    @property
    def made_of(self) -> tuple[tuple[str, float], ...]:
        """The materials of the completion and their shares, largest first."""
        return self._materials(self.weights.mean(axis=0))

    def _materials(self, weights: Array) -> tuple[tuple[str, float], ...]:
        names = (*self.samples.names, "Lambertian")
        totals = np.bincount(self.samples.material_of, weights, len(names))
        return tuple(
            (names[m], float(totals[m])) for m in np.argsort(-totals, kind="stable") if totals[m] > 0.005
        )[:6]


def complete(samples: LibrarySamples, readings: Readings) -> Completion:
    """Complete readings of a material to all directions, with the materials of a library as prior.

    Args:
        samples: of the library.
        readings: at P direction pairs.
    Raises:
        BandMismatchError: the bands of readings and library do not go together.
        UsageError: no reading is left, or all are zero.
    """
    readings = _usable(for_library(readings, samples.bands))
    at_readings = samples.at(readings.wi, readings.wo)
    return complete_at(samples, readings, at_readings)


def complete_at(
    samples: LibrarySamples, readings: Readings, at_readings: Array, at_gloss: Array | None = None
) -> Completion:
    """`complete`, given cube roots of samples at the readings (n + 1, P) and, unless None, at gloss (n + 1, G)."""
    weights = readings.weights * cosine_weight(readings.wi, readings.wo) ** (2.0 / 3.0)
    where, gram, group = places(readings.wi, readings.wo), samples.gram, samples.material_of
    gloss = _gloss(readings, samples.gloss(tuple(readings.gloss)) if at_gloss is None else at_gloss)
    of_mean = posterior(
        np.hstack([at_readings, gloss.samples]), np.append(_structure(readings), gloss.target),
        np.append(weights, gloss.weights), np.vstack([where, gloss.where]), gram, group,
    )  # fmt: skip
    targets = np.cbrt(np.maximum(readings.values, 0.0)).T
    found = band_mixtures(of_mean, at_readings, targets, weights, where, gram, group, gloss)
    made = completion_weights(at_readings, targets, weights, gram, found.mean)
    mixed, glossy = made @ at_readings, made @ gloss.samples
    nearby = nearby_factors(
        np.hstack([targets, gloss.scaled(glossy)]), np.hstack([mixed, glossy]), np.vstack([where, gloss.where]),
        np.append(readings.weights, gloss.weights),
    )  # fmt: skip
    whole = replace(nearby, strength=in_all_bands(nearby.strength, readings, samples.bands))
    return Completion(
        samples, readings, at_readings, found, in_all_bands(made, readings, samples.bands), whole,
        (mixed * nearby.at(where)).T ** 3,
    )  # fmt: skip


def _gloss(readings: Readings, samples: Array) -> GlossReadings:
    """The gloss of a material, with that of samples as cube roots (n + 1, G)."""
    meters = [gloss_meter(angle) for angle in readings.gloss]
    mean = [meter.mean_value(units) for meter, units in zip(meters, readings.gloss.values(), strict=True)]
    theta = np.deg2rad(list(readings.gloss), dtype=float)
    return GlossReadings(
        samples, np.cbrt(mean), luminance(np.eye(readings.bands.count), readings.bands),
        places(from_spherical(theta, np.pi), from_spherical(theta, 0.0)),
    )  # fmt: skip


def _usable(readings: Readings) -> Readings:
    """The measured readings of positive weight above the horizon."""
    is_usable = (readings.wi[:, 2] > 1e-3) & (readings.wo[:, 2] > 1e-3)
    is_usable &= readings.measured.any(axis=1) & (readings.weights > 0.0)
    left = readings.select_pairs(is_usable) if is_usable.any() else None
    if left is None or not np.nansum(np.maximum(left.values, 0.0)) > 0.0:
        raise UsageError(
            f"{readings.name}: none of {len(readings)} readings is above zero and above the horizon, expected "
            "one or more"
        )
    return left


def _structure(readings: Readings) -> Array:
    """Cube roots of the mean over bands at every reading, shape (P,)."""
    return np.cbrt(np.maximum(np.nanmean(np.maximum(readings.values, 0.0), axis=1), 0.0))
