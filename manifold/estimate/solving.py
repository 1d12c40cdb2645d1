"""Finds the weights of atoms that explain observations of a material, in two steps.

The first step computes mixtures of two materials and averages them by their posterior probability. The second step is
non-negative least squares (`model.estimator.explain`) with this average as prior, which determines the estimate in
unobserved directions. Without pictures, readings are compared in cube roots, and their residual corrects nearby
directions (`residual`). Pictures are sums of light, and are compared in values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from scipy.interpolate import PchipInterpolator

from manifold.core.errors import UsageError
from manifold.core.pairs import cosine_weight
from manifold.core.records import Array, Mask
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.channels import Channels
from manifold.estimate.evidence import Evidence, for_library, rows_of_gloss, rows_of_readings, usable_readings
from manifold.estimate.mixtures import (
    GlossReadings,
    Hypotheses,
    ReadingRoots,
    band_mixtures,
    log_sum,
    posterior,
)
from manifold.estimate.pixel_mixtures import GRID_STRIDE, MODEL_ERROR, PixelPosterior, pixel_mixtures
from manifold.estimate.residual import ResidualFactors, coordinates, residual_factors
from manifold.estimate.sightings import Sighting, unlit
from manifold.formats.readings import GlossUnits, Readings
from manifold.model.estimator import LEAST, Observation, explain

Seen: TypeAlias = Sighting | Readings | GlossUnits
"""An observation of a material: a picture, readings, or gloss units by angle in degrees."""

CONTRADICTION = 0.2
"""Relative cube-root error of readings predicted from the pictures alone above which the two contradict each other."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The explanation of observations in C bands or channels.

    Attributes:
        evidence: the observations; if there are pictures, with the assumed colour of the gloss.
        weights: weights of the atoms, shape (C, n).
        hypotheses: mixtures of materials and their probabilities, for all bands of readings together, or for each
            channel of a camera.
        channels: rows that were explained, in every channel of a camera and for the exposures; empty without
            pictures.
        factors: factors on cube roots near the readings, in their bands; None if there are pictures.
        exposures: factor by which each picture is brighter than its light and the material predict, shape (P,).
        residuals: relative cube-root error of every picture, shape (P,).
        contradiction: relative cube-root error of readings when the pictures alone predict them; 0 without both.
    """

    evidence: Evidence
    weights: Array
    hypotheses: Sequence[Hypotheses]
    channels: Sequence[Observation] = ()
    factors: ResidualFactors | None = None
    exposures: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Array = field(default_factory=lambda: np.zeros(0))
    contradiction: float = 0.0

    @property
    def errors(self) -> Array:
        """Relative cube-root error over all rows in every channel, with their weights in the fit, shape (C,)."""
        return np.array([rows.relative.error(w) for rows, w in zip(self.channels, self.weights, strict=True)])

    @property
    def residual_of_pixels(self) -> float:
        """Relative cube-root error of the pixels, as the root mean square over pictures."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def residual(self) -> float:
        """Largest relative cube-root error of pixels, readings and gloss; only with pictures."""
        others = [rows for rows in (self.evidence.of_readings, self.evidence.of_gloss) if rows]
        return max(self.residual_of_pixels, *(_error_of(rows, self.weights) for rows in others), 0.0)


def gather(
    atoms: LibraryAtoms,
    seen: Sequence[Seen],
    *,
    exposure: float | None = 1.0,
    each: bool = False,
    channels: Channels | None = None,
) -> Evidence:
    """Combine observations to evidence: pictures of one camera, readings of one specimen, and gloss.

    The other arguments are described in `Completion.of`. If there are pictures, the atoms must combine values
    (`in_values`).

    Raises:
        BandMismatchError: the bands of the readings and the library cannot be combined.
        UsageError: there are neither readings nor pictures, no reading can be used, or all readings are zero.
    """
    sightings = [one for one in seen if isinstance(one, Sighting)]
    readings = next((one for one in seen if isinstance(one, Readings)), None)
    gloss = {} if readings is None else dict(readings.gloss)
    gloss |= {angle: units for one in seen if isinstance(one, Mapping) for angle, units in one.items()}
    if not sightings:
        if readings is None:
            raise UsageError("found neither readings nor pictures of the material; give one of them")
        of_library = usable_readings(for_library(readings, atoms.bands))
        return Evidence.of_instruments(atoms, replace(of_library, gloss=gloss))
    sums = [sighting.sums(atoms) for sighting in sightings]
    strength = strength_of_spots(atoms, sightings, sums, exposure) if any(s.spots for s in sightings) else 0.0
    pictures = [s.rows(lit + strength * spots) for s, (lit, spots) in zip(sightings, sums, strict=True)]
    channels = channels or Channels.srgb(atoms.bands)
    of_readings: list[Observation] = []
    if readings is not None:
        readings = for_library(readings, atoms.bands)
        in_channels, channels = channels.beside(readings, atoms.bands)
        weight = float(np.mean([picture[0].weights.sum() for picture in pictures]))
        of_readings = rows_of_readings(atoms, in_channels, weight)
    return Evidence(
        readings, gloss, None, pictures, exposure, each, of_readings, (), channels.to_bands, strength, unlit(sightings)
    )  # fmt: skip


def solve(atoms: LibraryAtoms, evidence: Evidence, usable: Mask | None = None) -> Solution:
    """Find the weights of atoms that explain the evidence; `usable` (n,) is a mask of the atoms, by default all."""
    if not evidence.pictures:
        return _solve_readings(atoms, evidence, usable)
    solution = solve_pictures(atoms, evidence, usable)
    if evidence.gloss and not evidence.of_gloss:  # pictures say what colour highlights have
        weight = float(np.mean(np.concatenate([picture[0].weights for picture in evidence.pictures])))
        of_gloss = rows_of_gloss(atoms, evidence.gloss, solution.weights, weight)
        solution = solve_pictures(atoms, replace(evidence, of_gloss=of_gloss), usable)
    return solution


# -- readings ----------------------------------------------------------------------------------------------------------

_KEEP_ROOTS = 0.1  # weight of changes over all directions against residuals at readings
_FEW = (
    12.0  # sum of the weights of readings, cosines included, up to which that holds; more readings weigh more
)


def _solve_readings(atoms: LibraryAtoms, evidence: Evidence, usable: Mask | None) -> Solution:
    """Explain readings and gloss by cube roots of atoms."""
    readings, *at = evidence.read
    index = np.arange(len(atoms)) if usable is None else np.flatnonzero(usable)
    _, material_of = np.unique(atoms.material_of[index], return_inverse=True)
    n_library = len(set(atoms.material_of[index[index < atoms.n_measured]].tolist()))
    at_readings, at_gloss, gram = at[0][index], at[1][index], atoms.gram[np.ix_(index, index)]
    where = coordinates(readings.wi, readings.wo)
    weights = readings.weights * cosine_weight(readings.wi, readings.wo) ** (2.0 / 3.0)
    read = ReadingRoots(at_readings, np.cbrt(np.maximum(readings.values, 0.0)).T, weights, where)
    gloss = GlossReadings.of(evidence.gloss, readings.bands, at_gloss)
    all_where, ones = np.vstack([where, gloss.where]), np.ones(len(gloss.roots))
    of_mean = ReadingRoots(
        np.hstack([at_readings, gloss.atoms]), np.append(mean_roots(readings), gloss.roots)[None],
        np.append(weights, ones), all_where,
    )  # fmt: skip
    mixtures = posterior(of_mean, gram, material_of, n_library)
    hypotheses = band_mixtures(mixtures, read, gram, material_of, gloss, n_library)
    hypotheses = hypotheses.among(index, len(atoms))
    allowed = atoms.usable(hypotheses.mean)
    read = replace(read, atoms=at[0])
    combined = completion_weights(
        read, atoms.gram, hypotheses.mean, allowed if usable is None else allowed & usable
    )
    mixed, glossy = combined @ at[0], combined @ at[1]
    incidences_deg = np.append(
        np.rad2deg(np.arccos(np.clip(readings.wi[:, 2], -1.0, 1.0))), list(evidence.gloss)
    )
    factors = residual_factors(
        np.hstack([read.material, gloss.scaled(glossy)]), np.hstack([mixed, glossy]), all_where,
        incidences_deg, np.append(readings.weights, ones), readings.repeatability,
    )  # fmt: skip
    return Solution(evidence, combined, (hypotheses,), factors=factors)


def completion_weights(read: ReadingRoots, gram: Array, prior: Array, allowed: Mask | None = None) -> Array:
    """Return weights v >= 0 of atoms in every band, (B, n + 1), that fit the readings and stay near prior weights.

    They minimise `sum_p w (v g - t)^2 / |t|^2 + keep (v - s) G (v - s)`. g and t are cube roots of the atoms and of
    the material at readings with weights w; s (B, n + 1) is the prior; G (n + 1, n + 1) holds the inner products of
    the atoms, averaged over all directions. Only `allowed` atoms (n + 1,) get a weight.
    """
    is_read = np.isfinite(read.material)
    known = np.where(is_read, read.material, 0.0)
    norm = float(np.sum(read.weights * known**2)) / len(known)
    if norm == 0.0:
        return np.zeros(prior.shape)
    gain = max(float(read.weights.sum()), 1.0) / _FEW
    kept = _KEEP_ROOTS * gram * (read.weights.sum() / norm)
    rows = [
        Observation(read.atoms, row, gain * read.weights * mask / norm, np.zeros(len(row), bool), True)
        for row, mask in zip(known, is_read, strict=True)
    ]
    return explain(rows, [kept] * len(rows), prior, allowed)


def mean_roots(readings: Readings) -> Array:
    """Return cube roots of the mean over bands at every reading, shape (P,)."""
    mean = np.nanmean(np.maximum(readings.values, 0.0), axis=1)
    return np.asarray(np.cbrt(np.maximum(mean, 0.0)))


# -- pictures ----------------------------------------------------------------------------------------------------------

_EXPOSURES = np.geomspace(1.0 / 16.0, 16.0, 9)  # relative to that of a grey ball: evidence is computed there
_CANDIDATES = np.geomspace(1.0 / 16.0, 16.0, 129)  # where it is interpolated
_GREY = 0.3  # its albedo
_DARKEST = 0.01  # albedo: what is darker is as probable
_WHITE = 0.1  # standard deviation of the logarithm of what is brighter than white
_TEMPERED = (
    0.05  # weight of the evidence of pixels against the prior: the exposure is off by the least with it
)
_STRENGTHS = 4.0 ** np.arange(6)  # strengths to try for clipped spots, in addition to the clipped value
_FINER = 2.0 ** np.linspace(-0.8, 0.8, 5)  # about the best of these
_ROUNDS, _SETTLED = 8, 0.01  # rounds of gains and weights in turn, and largest change of the last
_EXPOSED = 2  # first rounds that estimate the common exposure; further ones change it by less than 2 %
_KEEP_VALUES = 1e-3  # weight of squared changes over all directions against those of pixels, both relative
_DARK = 0.05  # share of the root mean square of cube roots: changes of darker directions cost no more


def solve_pictures(atoms: LibraryAtoms, evidence: Evidence, usable: Mask | None = None) -> Solution:
    """Find the weights of usable atoms (n,) that explain pictures, with unknown exposures and noise.

    If there are readings, the pictures' noise is at least the error with which the pictures alone predict the
    readings.
    """
    contradiction = 0.0
    exposures = (evidence.exposure or 1.0) * _first_gains(atoms, evidence)
    if evidence.of_readings:
        alone = solve_pictures(atoms, replace(evidence, of_readings=()), usable)
        scale, contradiction = _scale_and_contradiction(evidence, alone.weights)
        exposures = alone.exposures * (scale if evidence.exposure is None else 1.0)
    least = max(MODEL_ERROR, contradiction)
    noise = np.full(len(exposures), least)
    for k in range(_ROUNDS):
        if evidence.exposure is None and not evidence.of_readings and k < _EXPOSED:
            gains = relative(exposures)
            exposures = probable_exposure(atoms, evidence, gains, usable) * gains
        channels = evidence.under(exposures, noise)
        if contradiction > CONTRADICTION:  # readings choose the prior, too
            channels = [replace(rows, n_beside=0) for rows in channels]
        weights, priors = estimate(atoms, channels, usable)
        residuals = residuals_of(evidence, weights, exposures)
        solution = Solution(
            evidence, weights, priors, channels, None, exposures, residuals, contradiction
        )  # fmt: skip
        exposures = _better_exposures(evidence, weights, exposures)
        noise, noise_before = np.maximum(residuals, least), noise
        changes = np.log([exposures / solution.exposures, noise / noise_before])
        if np.abs(changes).max() < _SETTLED or not (evidence.of_readings or len(exposures) > 1):
            break
    return solution


def estimate(
    atoms: LibraryAtoms, channels: Sequence[Observation], usable: Mask | None = None
) -> tuple[Array, list[Hypotheses]]:
    """Return non-negative weights (C, n) of usable atoms that explain C channels, and the mixtures as their prior.

    The prior uses only the pixels; if the library lacks the class of the material, readings would select a wrong
    class.
    """
    usable = np.ones(len(atoms), bool) if usable is None else usable
    priors = [pixel_mixtures(atoms, rows.pixels, usable) for rows in channels]
    mixed, G = np.vstack([prior.mean for prior in priors]), atoms.on_grid[:, ::GRID_STRIDE]
    means = np.cbrt(np.maximum(mixed @ G, 0.0))
    norms = np.sum(means**2, axis=1)
    norms = np.maximum(norms, _DARK * norms.mean() + np.finfo(float).tiny)
    kept = []
    for mean, norm in zip(means, norms, strict=True):
        least = _DARK * np.sqrt(norm / len(mean))
        cost = G / (3.0 * np.maximum(mean, least) ** 2 * np.sqrt(norm))
        kept.append(_KEEP_VALUES * cost @ cost.T)
    return explain([rows.relative for rows in channels], kept, mixed, usable), priors


def strength_of_spots(
    atoms: LibraryAtoms,
    sightings: Sequence[Sighting],
    sums: Sequence[tuple[Array, Array | float]],
    exposure: float | None,
) -> float:
    """Return the factor by which clipped spots of a light are brighter than their values, from a fit to the pixels.

    `sums` holds `Sighting.sums` of every sighting in this light; an exposure of None is unknown.
    """

    def off(strength: float) -> float:
        rows = [s.rows(lit + strength * spots) for s, (lit, spots) in zip(sightings, sums, strict=True)]
        solution = solve_pictures(atoms, Evidence(pictures=rows, exposure=exposure))
        return float(np.mean(solution.errors**2))

    tried = np.append(0.0, _STRENGTHS)
    best = float(tried[np.argmin([off(s) for s in tried])])
    finer = best * _FINER
    return float(finer[np.argmin([off(s) for s in finer])]) if best else 0.0


def _first_gains(atoms: LibraryAtoms, evidence: Evidence) -> Array:
    """Return relative exposures of pictures (P,) if they showed a grey ball; their geometric mean is 1."""
    if not evidence.has_gains:
        return np.ones(len(evidence.pictures))
    grey, gains = atoms.mixed[-1], []
    for picture in evidence.pictures:
        seen = sum(float(rows.weights @ np.maximum(rows.seen, 0.0)) for rows in picture)
        gains.append(seen / max(sum(float(rows.weights @ rows.atoms[grey]) for rows in picture), LEAST))
    return relative(np.array(gains))


def relative(gains: Array) -> Array:
    """Divide gains (P,) by their geometric mean."""
    return np.asarray(gains / geometric_mean(gains))


def geometric_mean(gains: Array) -> float:
    """Return the geometric mean of gains (P,)."""
    return float(np.exp(np.mean(np.log(np.maximum(gains, np.finfo(float).tiny)))))


def _better_exposures(evidence: Evidence, weights: Array, exposures: Array) -> Array:
    """Return exposures (P,), unknown ones as weights (C, n) predict the pictures."""
    ratios = np.array([ratio_of(picture, weights) for picture in evidence.pictures])
    if evidence.exposure is None and evidence.of_readings:
        return ratios if evidence.each else np.full(len(ratios), geometric_mean(ratios))
    return geometric_mean(exposures) * relative(ratios) if evidence.has_gains else exposures


def ratio_of(rows: Sequence[Observation], weights: Array) -> float:
    """Return the factor by which rows in C channels exceed the predictions of weights (C, n), fitted to cube roots."""
    products = squares = 0.0
    for one, w in zip(rows, weights, strict=True):
        used = ~one.is_bound
        made, seen = np.cbrt(np.maximum([w @ one.atoms, one.seen], 0.0))
        products += float(np.sum(one.weights[used] * made[used] * seen[used]))
        squares += float(np.sum(one.weights[used] * made[used] ** 2))
    return max((products / max(squares, np.finfo(float).tiny)) ** 3, np.finfo(float).tiny)


def _scale_and_contradiction(evidence: Evidence, weights: Array) -> tuple[float, float]:
    """Return the factor by which weights (C, n) are brighter than readings, and the relative error of cube roots.

    The factor is not part of the error where the exposure of pictures is unknown.
    """
    scale = 1.0 / ratio_of(evidence.of_readings, weights)
    made = weights / scale if evidence.exposure is None else weights
    return scale, _error_of(evidence.of_readings, made)


def probable_exposure(
    atoms: LibraryAtoms, evidence: Evidence, gains: Array, usable: Mask | None = None
) -> float:
    """Return the exposure with which the usable atoms (n,) best explain the pictures, given their relative gains (P,).

    It is computed as the posterior mean of the logarithm. The prior is the brightness of the library's materials in
    these pixels, at most white. The contrast of highlights adds little information, because many mixtures have the
    same contrast.
    """
    every = np.ones(len(atoms), bool) if usable is None else usable
    grey, n = atoms.mixed[-1], atoms.n_measured
    pictures = [rows.pixels for rows in evidence.under(gains)]
    seen = sum(float(rows.weights @ np.maximum(rows.seen, 0.0)) for rows in pictures)
    of_atoms = np.sum([rows.atoms @ rows.weights for rows in pictures], axis=0)
    lit = float(of_atoms[grey])
    brightness = np.log(np.maximum(of_atoms[:n][every[:n]] / lit, _DARKEST))
    of_grey = seen / (_GREY * lit)
    log_albedo = np.log(_GREY / _CANDIDATES)
    log = -0.5 * ((log_albedo - brightness.mean()) / max(brightness.std(), 0.1)) ** 2
    log -= 0.5 * (np.maximum(log_albedo, 0.0) / _WHITE) ** 2
    weight = 1.0 if evidence.of_readings or evidence.of_gloss else _TEMPERED
    channels = [PixelPosterior.of(atoms, rows, every, of_grey * _EXPOSURES) for rows in evidence.under(gains)]
    of_pixels = [sum(channel.at(e).evidence for channel in channels) for e in range(len(_EXPOSURES))]
    # Splines of the evidence, which is smooth, are as exact as twice as many exposures.
    log += weight * PchipInterpolator(np.log(_EXPOSURES), of_pixels)(np.log(_CANDIDATES))
    return of_grey * float(np.exp(np.exp(log - log_sum(log)) @ np.log(_CANDIDATES)))


def residuals_of(evidence: Evidence, weights: Array, exposures: Array) -> Array:
    """Return the relative cube-root error of every picture (P,), as the root mean square over channels."""
    return np.array(
        [
            _error_of([rows.scaled(at) for rows in picture], weights)
            for picture, at in zip(evidence.pictures, exposures.tolist(), strict=True)
        ]
    )


def _error_of(channels: Sequence[Observation], weights: Array) -> float:
    """Return the relative cube-root error of rows in C channels for weights (C, n), root mean square over channels."""
    errors = [rows.relative.error(w) for rows, w in zip(channels, weights, strict=True)]
    return float(np.sqrt(np.mean(np.square(errors))))
