"""The material of photographed balls: its BRDF and expected errors.

A prior of mixtures of two materials, then non-negative least squares. What no lamp lights is not in the pixels: there
the estimate follows the mixtures that explain the pixels, and differences from their posterior mean cost, direction by
direction, in cube roots.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from manifold import __version__
from manifold.colour import panel
from manifold.colour.conversion import luminance, srgb_to_xyz
from manifold.estimate.atoms import LibraryAtoms, shown_shares
from manifold.estimate.expected import Calibration, cached
from manifold.estimate.gloss import value_of_unit
from manifold.estimate.mixtures import (
    LAMBERTIAN_SPREAD,
    NOISE,
    Hypotheses,
    Mixtures,
    atom_pairs,
    products,
)
from manifold.estimate.sightings import Sighting, unlit
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.model.estimator import LEAST, Observation, explain
from manifold.model.prediction import PredictedBRDF
from manifold.pairs import cosine_weight
from manifold.records import Array, Bands, Indices, Mask, evenly_spaced

CONTRADICTION = 0.2
"""Relative error of cube roots of readings, predicted from pictures alone, above which the two contradict."""

_LEFT_OUT = 16  # materials by which expected errors are calibrated
_CHANNELS_NM = (610.0, 550.0, 465.0)  # bands that stand for the channels of left-out materials
_EXPOSURES = np.geomspace(1.0 / 16.0, 16.0, 17)  # candidates, relative to the exposure of a grey ball
_GREY = 0.3  # its albedo
_DARKEST = 0.01  # albedo: what is darker is as probable
_WHITE = 0.1  # standard deviation of the logarithm of what is brighter than white
_TEMPERED = (
    0.05  # weight of the evidence of pixels against the prior: the exposure is off by the least with it
)
_NEGLIGIBLE = 40.0  # logarithm of the ratio of probabilities: exposures that are less probable do not count
_STRENGTHS = 4.0 ** np.arange(6)  # candidates for spots in a clipped light, beside what is in its picture
_FINER = 2.0 ** np.linspace(-0.8, 0.8, 5)  # about the best of these
_ROUNDS, _SETTLED = 8, 0.01  # rounds of gains and weights in turn, and largest change of the last
_MUCH_LESS = 0.7  # share of a residual
_UNEXPLAINED = 0.03  # residual that noise can make
_GRID_STRIDE = 7  # one in this many directions of the encoding grid is enough to compare mixtures
_MODEL_ERROR = 0.05  # standard deviation of cube roots of pixels about the best mixture, relative
_INDEPENDENT = 30.0  # number of pixels of a picture whose errors are independent
_READING = (_MODEL_ERROR / NOISE) ** 2 / _INDEPENDENT  # weight of a reading, of that of a picture
_EXPONENT = 2.0  # power of the norm of mixtures by which their likelihood is divided
_KEEP = 1e-3  # weight of squared changes over all directions against those of pixels, both relative
_DARK = 0.05  # share of the root mean square of cube roots: changes of darker directions cost no more
_COUNT = 200  # mixtures of which the mean is taken


@dataclass(frozen=True, eq=False, repr=False)
class PhotoMaterial:
    """A material found in photographs.

    Attributes:
        solution: weights of atoms in the channels of the camera, and exposures of the photographs.
        to_bands: from channels to the bands of the result, shape (B, 3).
        evidence: photographs, readings and gloss.
        residual: relative error of cube roots of pixels.
        spread: of the mixtures that explain the pixels, relative, over all directions.
        unlit: what the light cannot tell, in sentences.
        library: in whose cache the calibration is kept, if any.
        bands: of the result: those of the library, or of spectra read beside photographs and an RGB library.
        strength: of spots in a clipped light, see `strength_of_spots`; 0 without any.
    """

    atoms: LibraryAtoms
    solution: Solution
    to_bands: Array
    evidence: Evidence
    residual: float
    spread: float
    unlit: tuple[str, ...]
    bands: Bands
    library: Library | None = None
    strength: float = 0.0

    def __repr__(self) -> str:
        like = ", ".join(f"{share:.2f} {name}" for name, share in self.made_of[:3])
        return f"<PhotoMaterial: residual {self.residual:.1%}, {like}>"

    @cached_property
    def brdf(self) -> PredictedBRDF:
        """The BRDF; in spectral bands slightly negative where colours are saturated."""
        return self.atoms.predicted(self.to_bands @ self.weights, self.bands)

    @cached_property
    def calibration(self) -> Calibration:
        """Errors of the library's materials, left out, in the same pixels."""
        if self.library is None:
            return calibrated(self.atoms, self.evidence, self.exposures)
        return cached(
            self.library,
            _cache_key(self.atoms, self.evidence, self.exposures, self.library),
            lambda: calibrated(self.atoms, self.evidence, self.exposures),
        )

    @property
    def weights(self) -> Array:
        """Weights of atoms in the channels of the camera, shape (3, n)."""
        return self.solution.weights

    @property
    def channels(self) -> Sequence[Observation]:
        """The measured values of each channel, under the exposures."""
        return self.solution.channels

    @property
    def exposures(self) -> Array:
        """By which factor each photograph is brighter than light and material predict, shape (P,)."""
        return self.solution.exposures

    @property
    def exposure(self) -> float:
        """The geometric mean of the exposures."""
        return _mean(self.exposures)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences on parts that the light cannot determine, and on the agreement of light and photographs."""
        notes = self.unlit
        if self.strength > 0.0:
            notes += (
                f"the light is clipped: by the pixels its spots are {1.0 + self.strength:.3g} times as bright as in "
                "its picture; expected errors take that as known",
            )
        if self._of_differing_exposures is not None:
            notes += (self._of_differing_exposures,)
        if self.residual <= _UNEXPLAINED or not self.calibration.is_beyond(self.residual):
            return notes
        return (
            f"no material explains the pixels (residual {100.0 * self.residual:.3g} %, of left-out materials at most "
            f"{100.0 * self.calibration.largest_residual:.3g} %): check the light, its turn and exposure, and "
            "the circle",
            *notes,
        )

    @cached_property
    def _of_differing_exposures(self) -> str | None:
        """Say that pictures which were taken as equally exposed agree better with an exposure each; None if not."""
        if self.evidence.each or len(self.evidence.pictures) == 1 or self.residual <= _UNEXPLAINED:
            return None
        apart = solve(self.atoms, replace(self.evidence, each=True))
        residual, gains = float(indicators(self.atoms, apart)[0]), _relative(apart.exposures)
        if residual > _MUCH_LESS * self.residual:
            return None
        return (
            f"the pixels have a residual of {100.0 * self.residual:.2g} % with one exposure for all pictures, and of "
            f"{100.0 * residual:.2g} % with {gains.min():.2g} to {gains.max():.2g} times their mean: if "
            "the lamp or the camera's settings differed, give --exposure each"
        )

    @cached_property
    def expected(self) -> Errors[float]:
        """Expected errors."""
        return self.calibration.at(np.array([self.residual, self.spread]))

    @cached_property
    def predicted(self) -> tuple[float, ...]:
        """Relative errors of the cube roots of every photograph if the other observations predict it.

        Exposures are known then, but for that of the photograph. There are none of a single photograph.
        """
        pictures = [
            [rows.scaled(exposure) for rows in picture]
            for picture, exposure in zip(self.evidence.pictures, self.exposures.tolist(), strict=True)
        ]
        if len(pictures) == 1:
            return ()
        errors = []
        for k, picture in enumerate(pictures):
            others = replace(
                self.evidence, pictures=[*pictures[:k], *pictures[k + 1 :]], exposure=1.0, each=False
            )
            weights = solve(self.atoms, others).weights
            gain = np.array([_ratio(picture, weights)])
            errors.append(float(_residuals(replace(others, pictures=[picture]), weights, gain)[0]))
        return tuple(errors)

    @property
    def made_of(self) -> tuple[tuple[str, float], ...]:
        """Materials, coats and lobes with their shares of the light that the ball sends, largest first."""
        names = (*self.atoms.names, *self.atoms.coats, "analytic lobes")
        light = self.weights.mean(axis=0) * self.atoms.on_ball.sum(axis=1)
        totals = np.bincount(self.atoms.material_of, light, len(names))
        return shown_shares(names, totals / max(totals.sum(), np.finfo(float).tiny))


Seen = Sighting | Readings | Mapping[float, float]
"""Data on a material: a photograph, readings, or gloss units by angle in degrees."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Observations of a material by cameras and instruments.

    Attributes:
        pictures: rows of every picture in each of C channels, as its pixels are.
        readings: in each channel; empty without any.
        gloss: in each channel; empty without any.
        exposure: factor of the pictures over light times material; None if it is unknown.
        each: whether every picture has an exposure of its own about that.
    """

    pictures: Sequence[Sequence[Observation]]
    exposure: float | None = 1.0
    each: bool = False
    readings: Sequence[Observation] = ()
    gloss: Sequence[Observation] = ()

    @property
    def has_gains(self) -> bool:
        """Whether exposures of pictures relative to each other are to be estimated."""
        return self.each and len(self.pictures) > 1

    def under(self, exposures: Array, noise: Array | None = None) -> list[Observation]:
        """Return the measured values of every channel, under exposures (P,) of the pictures.

        Pictures of more than the usual noise (P,) count less.
        """
        counts = np.ones(len(exposures)) if noise is None else (_MODEL_ERROR / noise) ** 2
        channels = []
        for c in range(len(self.pictures[0])):
            parts = [
                replace(picture[c].scaled(exposure), weights=count * picture[c].weights)
                for picture, exposure, count in zip(
                    self.pictures, exposures.tolist(), counts.tolist(), strict=True
                )
            ]
            rows = Observation.joined(parts)
            for others in (self.readings, self.gloss):
                rows = rows.beside(others[c]) if others else rows
            channels.append(rows)
        return channels

    def of_another(self, own: Indices, exposures: Array) -> Evidence:
        """Return what these pictures and instruments would show of three atoms `own`, under exposures (P,)."""
        pictures = [
            [seen_instead(rows.scaled(at), rows.atoms[k]) for rows, k in zip(picture, own, strict=True)]
            for picture, at in zip(self.pictures, exposures.tolist(), strict=True)
        ]
        readings, gloss = (
            [replace(rows, seen=rows.atoms[k]) for rows, k in zip(others, own, strict=True)] if others else []
            for others in (self.readings, self.gloss)
        )
        exposure = None if self.exposure is None else 1.0
        return replace(self, pictures=pictures, readings=readings, gloss=gloss, exposure=exposure)


@dataclass(frozen=True, eq=False)
class Solution:
    """The explanation of observations.

    Attributes:
        weights: of atoms in every channel, shape (C, n).
        priors: mixtures of every channel.
        channels: observations by channel, under the exposure and gains.
        exposures: of every picture, shape (P,).
        residuals: relative error of cube roots of every picture, shape (P,).
        contradiction: the same of readings as pictures alone predict them; 0 without any.
    """

    weights: Array
    priors: Sequence[Hypotheses]
    channels: Sequence[Observation]
    exposures: Array
    residuals: Array
    contradiction: float = 0.0


def solve(atoms: LibraryAtoms, evidence: Evidence, usable: Mask | None = None) -> Solution:
    """Explain evidence by usable atoms (n,); unknown exposures and the noise of pictures are part of the estimate.

    Where there are readings, the pictures' noise is at least the error of these as pictures alone predict them.
    """
    contradiction = 0.0
    exposures = (evidence.exposure or 1.0) * _first_gains(atoms, evidence)
    if evidence.readings:
        alone = solve(atoms, replace(evidence, readings=()), usable)
        scale, contradiction = _scale_and_contradiction(evidence, alone.weights)
        exposures = alone.exposures * (scale if evidence.exposure is None else 1.0)
    least = max(_MODEL_ERROR, contradiction)
    noise = np.full(len(exposures), least)
    for _ in range(_ROUNDS):
        if evidence.exposure is None and not evidence.readings:
            gains = _relative(exposures)
            exposures = probable_exposure(atoms, evidence, gains, usable) * gains
        channels = evidence.under(exposures, noise)
        if contradiction > CONTRADICTION:  # readings choose the prior, too
            channels = [replace(rows, n_beside=0) for rows in channels]
        weights, priors = estimate(atoms, channels, usable)
        residuals = _residuals(evidence, weights, exposures)
        solution = Solution(weights, priors, channels, exposures, residuals, contradiction)
        exposures = _better_exposures(evidence, weights, exposures)
        noise, noise_before = np.maximum(residuals, least), noise
        changes = np.log([exposures / solution.exposures, noise / noise_before])
        if np.abs(changes).max() < _SETTLED or not (evidence.readings or len(exposures) > 1):
            break
    return solution


def find_material(
    atoms: LibraryAtoms,
    seen: Sequence[Seen],
    to_bands: Array,
    *,
    exposure: float | None = 1.0,
    each: bool = False,
    bands: Bands | None = None,
    library: Library | None = None,
) -> PhotoMaterial:
    """Find the material that explains photographs, with readings in the same channels and gloss if there are any.

    At least one is a photograph, and all are by one camera; `to_bands` is the matrix (B, 3) from channels to the bands
    of the result, by default those of the library, see `photographs.band_matrix`. The photographs'
    exposure is relative to the light; None finds the one that the library's materials, and what else was seen, make
    most probable; with `each`, every photograph has its own about this one. The library keeps errors of left-out
    materials in its cache.
    """
    sightings = [one for one in seen if isinstance(one, Sighting)]
    sums = [sighting.sums(atoms) for sighting in sightings]
    strength = strength_of_spots(atoms, sightings, sums, exposure) if any(s.spots for s in sightings) else 0.0
    pictures = [s.rows(lit + strength * spots) for s, (lit, spots) in zip(sightings, sums, strict=True)]
    readings = [one for one in seen if isinstance(one, Readings)]
    gloss = {angle: units for one in seen if isinstance(one, Mapping) for angle, units in one.items()}
    gloss = {angle: units for one in readings for angle, units in one.gloss.items()} | gloss
    channels = range(len(pictures[0]))
    of_readings: list[Observation] = []
    if readings:
        weight = float(np.mean([picture[0].weights.sum() for picture in pictures]))
        of_readings = [
            Observation.joined([_of_readings(atoms, one, c, weight) for one in readings]) for c in channels
        ]
    evidence = Evidence(pictures, exposure, each, of_readings)
    solution = solve(atoms, evidence)
    if gloss:  # photographs say what colour highlights have
        weight = float(np.mean(np.concatenate([picture[0].weights for picture in pictures])))
        evidence = replace(evidence, gloss=_of_gloss(atoms, gloss, solution.weights, weight))
        solution = solve(atoms, evidence)
    residual, spread = indicators(atoms, solution)
    return PhotoMaterial(
        atoms,
        solution,
        to_bands,
        evidence,
        residual,
        spread,
        unlit(sightings),
        bands or atoms.bands,
        library,
        strength,
    )


def strength_of_spots(
    atoms: LibraryAtoms,
    sightings: Sequence[Sighting],
    sums: Sequence[tuple[Array, Array | float]],
    exposure: float | None,
) -> float:
    """Return how many times brighter than its clipped value a light's spots are, from the best fit of the pixels.

    For sums of the pixels of sightings in this light see `Sighting.sums`; an exposure of None is not known.
    """

    def off(strength: float) -> float:
        rows = [s.rows(lit + strength * spots) for s, (lit, spots) in zip(sightings, sums, strict=True)]
        solution = solve(atoms, Evidence(rows, exposure))
        return float(np.mean(_channel_errors(solution) ** 2))

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
    return _relative(np.array(gains))


def _relative(gains: Array) -> Array:
    """Divide gains (P,) by their geometric mean."""
    return np.asarray(gains / _mean(gains))


def _mean(gains: Array) -> float:
    """Return the geometric mean of gains (P,)."""
    return float(np.exp(np.mean(np.log(np.maximum(gains, np.finfo(float).tiny)))))


def _better_exposures(evidence: Evidence, weights: Array, exposures: Array) -> Array:
    """Return exposures (P,), unknown ones as weights (C, n) predict the pictures."""
    ratios = np.array([_ratio(picture, weights) for picture in evidence.pictures])
    if evidence.exposure is None and evidence.readings:
        return ratios if evidence.each else np.full(len(ratios), _mean(ratios))
    return _mean(exposures) * _relative(ratios) if evidence.has_gains else exposures


def _ratio(rows: Sequence[Observation], weights: Array) -> float:
    """Return by which factor rows in C channels are larger than weights (C, n) predict, by their cube roots."""
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
    scale = 1.0 / _ratio(evidence.readings, weights)
    made = weights / scale if evidence.exposure is None else weights
    errors = [rows.relative.error(w) for rows, w in zip(evidence.readings, made, strict=True)]
    return scale, float(np.sqrt(np.mean(np.square(errors))))


def _of_readings(atoms: LibraryAtoms, readings: Readings, channel: int, of_pixels: float) -> Observation:
    """Return readings of one channel; each counts as a part of a picture, whose weights have a sum.

    They are reflectance factors times a cosine, as pixels are; those brighter than white are scaled to it.
    """
    is_read = np.isfinite(readings.values[:, channel]) & (readings.weights > 0.0)
    wi, wo = readings.wi[is_read], readings.wo[is_read]
    weights = readings.weights[is_read]
    weights = weights * of_pixels * _READING / max(weights.mean(), np.finfo(float).tiny)
    seen = np.maximum(readings.values[is_read, channel], 0.0)
    scale = cosine_weight(wi, wo) * np.pi
    scale /= np.maximum(scale * seen, 1.0)
    return Observation(atoms.at(wi, wo) * scale, seen * scale, weights, np.zeros(len(wi), bool))


def _of_gloss(
    atoms: LibraryAtoms, gloss: Mapping[float, float], made: Array, weight: float
) -> list[Observation]:
    """Return gloss of some weight in every channel, of the colour that weights (3, n) give it."""
    means, unit = atoms.gloss(tuple(gloss)), np.array([value_of_unit(angle) for angle in gloss])
    read = unit * list(gloss.values())
    of_channels = np.maximum(made @ means, np.finfo(float).tiny)
    seen = read * of_channels / luminance(of_channels.T, Bands(None))
    weights = np.full(len(read), weight)
    scale = 1.0 / np.maximum(seen, unit)
    return [
        Observation(means * k, row * k, weights, np.zeros(len(row), bool))
        for row, k in zip(seen, scale, strict=True)
    ]


def probable_exposure(
    atoms: LibraryAtoms, evidence: Evidence, gains: Array, usable: Mask | None = None
) -> float:
    """Return the exposure at which the library's usable materials (n,) best explain evidence under gains (P,).

    It is the posterior mean of its logarithm. The prior is that of how bright they are in these pixels, none brighter
    than white. The ratio of highlights to what is beside them says the rest, and counts little: many mixtures have it.
    """
    every = np.ones(len(atoms), bool) if usable is None else usable
    grey, n = atoms.mixed[-1], atoms.n_measured
    pictures = [rows.pixels for rows in evidence.under(gains)]
    seen = sum(float(rows.weights @ np.maximum(rows.seen, 0.0)) for rows in pictures)
    of_atoms = np.sum([rows.atoms @ rows.weights for rows in pictures], axis=0)
    lit = float(of_atoms[grey])
    brightness = np.log(np.maximum(of_atoms[:n][every[:n]] / lit, _DARKEST))
    tried = _EXPOSURES * seen / (_GREY * lit)
    log_albedo = np.log(seen / lit / tried)
    prior = -0.5 * ((log_albedo - brightness.mean()) / max(brightness.std(), 0.1)) ** 2
    prior -= 0.5 * (np.maximum(log_albedo, 0.0) / _WHITE) ** 2
    weight = 1.0 if evidence.readings or evidence.gloss else _TEMPERED
    channels = [PixelPosterior.of(atoms, rows, every, tried) for rows in evidence.under(gains)]
    log = np.full(len(tried), -np.inf)
    for e in np.argsort(-prior, kind="stable").tolist():
        # The evidence is at most 1, and its logarithm at most 0.
        if prior[e] > log.max() - _NEGLIGIBLE:
            log[e] = prior[e] + weight * sum(channel.at(e).evidence for channel in channels)
    return float(np.exp(np.exp(log - logsumexp(log)) @ np.log(tried)))


def _residuals(evidence: Evidence, weights: Array, exposures: Array) -> Array:
    """Return the relative error of every picture, root mean square over channels, (P,)."""
    errors = [
        [rows.scaled(at).relative.error(w) for rows, w in zip(picture, weights, strict=True)]
        for picture, at in zip(evidence.pictures, exposures.tolist(), strict=True)
    ]
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=1)))


def _channel_errors(solution: Solution) -> Array:
    """Return the relative error of every channel, (C,)."""
    return np.array(
        [rows.relative.error(w) for rows, w in zip(solution.channels, solution.weights, strict=True)]
    )


def indicators(atoms: LibraryAtoms, solution: Solution) -> Array:
    """Return residual and spread, root mean square over channels, from which errors are predicted: (2,)."""
    grid = atoms.on_grid[:, ::_GRID_STRIDE]
    spreads = [prior.spread(np.cbrt(prior.weights @ grid)) for prior in solution.priors]
    return np.sqrt(np.mean(np.square(np.stack([_channel_errors(solution), np.array(spreads)])), axis=1))


def calibrated(atoms: LibraryAtoms, evidence: Evidence, exposures: Array) -> Calibration:
    """Measure errors of the library's materials, each estimated from the others in the same pixels and light.

    Exposures (P,) are those of the photographs: what was not known of these is not known of left-out materials.
    """

    def method(m: int) -> tuple[Errors[float], Array]:
        own = channel_atoms(atoms, m)
        solution = solve(atoms, evidence.of_another(own, exposures), atoms.material_of != m)
        return errors_of(atoms, own, solution.weights), indicators(atoms, solution)

    return Calibration.leave_out(method, evenly_spaced(len(atoms.names), _LEFT_OUT).tolist())


def channel_atoms(atoms: LibraryAtoms, material: int) -> Indices:
    """Return the three atoms of a material of the library that correspond to the channels of a camera."""
    axis = atoms.band_axis
    nm = axis.wavelengths_nm
    if nm is None:
        return material * axis.count + np.arange(3)
    return material * axis.count + np.array([np.abs(np.subtract(nm, at)).argmin() for at in _CHANNELS_NM])


def _cache_key(atoms: LibraryAtoms, evidence: Evidence, exposures: Array, library: Library) -> str:
    """Return a hash of all that a calibration depends on: the library, the pixels' weights of it, this program."""
    unknown = evidence.exposure is None, evidence.has_gains
    digest = hashlib.sha256(
        f"photo in lights {__version__} {library.content_hash} {atoms.coats} {unknown}".encode()
    )
    for exposure, picture in zip(exposures.tolist(), evidence.pictures, strict=True):
        for rows in picture:
            for array in (rows.atoms, rows.weights, np.array(_clipping(rows) / exposure)):
                digest.update(array.tobytes())
    for rows in (*evidence.readings, *evidence.gloss):
        digest.update(rows.atoms.tobytes())
        digest.update(rows.weights.tobytes())
    return digest.hexdigest()


def _clipping(rows: Observation) -> float:
    """Return the value at which the camera clipped pixels."""
    return float(rows.seen[rows.is_bound].min()) if rows.is_bound.any() else np.inf


def seen_instead(rows: Observation, seen: Array) -> Observation:
    """Return the pixels of another material, clipped at the same level."""
    level = _clipping(rows)
    is_bound = (seen >= level) & (np.arange(len(seen)) < len(seen) - rows.n_beside)
    return replace(rows, seen=np.where(is_bound, level, seen), is_bound=is_bound)


def errors_of(atoms: LibraryAtoms, own: Indices, weights: Array) -> Errors[float]:
    """Return the errors of weights (3, n) against three atoms `own`."""
    truth, made = atoms.on_grid[own].T, (weights @ atoms.on_grid).T
    balls = [srgb_to_xyz(np.clip(ball.T, 0.0, 1.0)) for ball in (atoms.on_ball[own], weights @ atoms.on_ball)]
    return panel.judged().compare(*balls) | Errors.of_values(truth, made)  # cosines are in the values


def estimate(
    atoms: LibraryAtoms, channels: Sequence[Observation], usable: Mask | None = None
) -> tuple[Array, list[Hypotheses]]:
    """Return weights (C, n) of usable atoms, never negative, that explain C channels, and mixtures of each as prior.

    That is of pixels alone: readings of a kind of material that the library lacks would choose a wrong one.
    """
    usable = np.ones(len(atoms), bool) if usable is None else usable
    priors = [pixel_mixtures(atoms, rows.pixels, usable) for rows in channels]
    mixed, G = np.vstack([prior.mean for prior in priors]), atoms.on_grid[:, ::_GRID_STRIDE]
    means = np.cbrt(np.maximum(mixed @ G, 0.0))
    norms = np.sum(means**2, axis=1)
    norms = np.maximum(norms, _DARK * norms.mean() + np.finfo(float).tiny)
    kept = []
    for mean, norm in zip(means, norms, strict=True):
        least = _DARK * np.sqrt(norm / len(mean))
        cost = G / (3.0 * np.maximum(mean, least) ** 2 * np.sqrt(norm))
        kept.append(_KEEP * cost @ cost.T)
    return explain([rows.relative for rows in channels], kept, mixed, usable), priors


@dataclass(frozen=True, eq=False)
class PixelPosterior:
    """Posterior probabilities of mixtures of two usable atoms, given one channel's pixels, under several exposures.

    As `posterior` has it for readings; mixtures and errors are of values, and those of bounds that hold are none.
    Pixels brighter than `LEAST` have a noise in proportion to them, others one noise. Their inner products scale with
    the exposure and are summed once.

    Attributes:
        exposures: divisors of the observed values, ascending, shape (E,).
        material_of: of the Q usable atoms that are mixed, shape (Q,).
        n_library: how many of the materials are measured.
        bright, dark: inner products of atoms under every exposure, over its square and as they are, (E, Q, Q).
        with_bright, with_dark: likewise with what was seen, over the exposure and times it, (E, Q).
        square_bright, square_dark: likewise of what was seen, as they are and times the exposure squared, (E,).
        bounds: atoms (Q, b), observed values (b,) and roots of weights (b,) of clipped pixels.
        of_grid: products of mixtures over all directions, see `mixtures.products`.
    """

    exposures: Array
    material_of: Indices
    n_library: int
    bright: Array
    dark: Array
    with_bright: Array
    with_dark: Array
    square_bright: Array
    square_dark: Array
    bounds: tuple[Array, Array, Array]
    of_grid: tuple[Array, Array, float]

    @classmethod
    def of(cls, atoms: LibraryAtoms, rows: Observation, usable: Mask, exposures: Array) -> PixelPosterior:
        """Sum the products of pixels of usable atoms (n,)."""
        index = atoms.mixed[usable[atoms.mixed]]
        _, material_of = np.unique(atoms.material_of[index], return_inverse=True)
        A, is_seen = rows.atoms[index], ~rows.is_bound
        roots = np.sqrt(_INDEPENDENT * rows.weights / rows.weights.sum()) / (3.0 * _MODEL_ERROR)
        B, seen, b = A[:, is_seen], np.maximum(rows.seen[is_seen], 0.0), roots[is_seen]
        E, Q = len(exposures), len(index)
        inner, with_seen, square = np.zeros((2, E, Q, Q)), np.zeros((2, E, Q)), np.zeros((2, E))
        n_bright = np.searchsorted(LEAST * exposures, seen)  # exposures under which a pixel is brighter
        for count in np.unique(n_bright).tolist():
            own = n_bright == count
            some, s = B[:, own], seen[own]
            for k, at in enumerate((slice(count), slice(count, None))):
                if exposures[at].size:
                    noise = LEAST if k else s
                    X, y = some * (b[own] / noise), s * b[own] / noise
                    inner[k, at] += X @ X.T
                    with_seen[k, at] += X @ y
                    square[k, at] += y @ y
        n = int(material_of[-1])
        on_grid = atoms.grid_products(_GRID_STRIDE)[np.ix_(index, index)]
        bounds = A[:, rows.is_bound], rows.seen[rows.is_bound], roots[rows.is_bound]
        return cls(
            exposures, material_of, n - len(atoms.coats), inner[0], inner[1], with_seen[0], with_seen[1], square[0],
            square[1], bounds, products(on_grid, *atom_pairs(n, (Q - 1) // n)),
        )  # fmt: skip

    def at(self, e: int) -> Mixtures:
        """Return the mixtures under one of the exposures, by index."""
        t = float(self.exposures[e])
        inner = t * t * self.bright[e] + self.dark[e]
        with_seen = t * self.with_bright[e] + self.with_dark[e] / t
        square = float(self.square_bright[e] + self.square_dark[e] / t**2)
        mixtures = Mixtures.of_products(inner, with_seen, square, self.material_of, self.n_library)
        misfit, (A, seen, roots) = mixtures.misfit, self.bounds
        scale = roots / np.maximum(seen / t, LEAST)
        for row, bound in zip((A * scale).T, seen / t * scale, strict=True):
            misfit = misfit + np.maximum(bound - mixtures.of(row), 0.0) ** 2
        # A Lambertian as bright as what was seen, or black to the eye.
        albedo = max(float(with_seen[-1]) / (float(inner[-1, -1]) + LAMBERTIAN_SPREAD**-2), LEAST)
        relative = np.maximum(mixtures.norm_of(self.of_grid) / (albedo**2 * self.of_grid[2]), 1.0)
        return replace(mixtures, misfit=misfit).weighed(_INDEPENDENT, relative, _EXPONENT)


def pixel_mixtures(atoms: LibraryAtoms, rows: Observation, usable: Mask) -> Hypotheses:
    """Return the most probable of the mixtures under one exposure, in one channel."""
    mixtures = PixelPosterior.of(atoms, rows, usable, np.ones(1)).at(0)
    best = mixtures.most_probable(_COUNT)
    probability = mixtures.probability[best] / mixtures.probability[best].sum()
    weights = np.zeros((len(best), len(atoms)))
    weights[:, atoms.mixed[usable[atoms.mixed]]] = mixtures.weights(best)
    return Hypotheses(probability, weights, (probability @ weights)[None])
