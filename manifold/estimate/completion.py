"""Completion of readings in the bands of a library: the posterior over mixtures of atoms, and its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.colour.narrow_bands import with_spectra
from manifold.errors import BandMismatchError, UsageError
from manifold.estimate.atoms import LibraryAtoms, ball_coordinates, grid_coordinates, shown_shares
from manifold.estimate.gloss import gloss_differences, gloss_units
from manifold.estimate.mixtures import GlossReadings, Hypotheses, ReadingRoots, band_mixtures, posterior
from manifold.estimate.residual import AdjustedBRDF, ResidualFactors, coordinates, residual_factors
from manifold.formats.readings import DAYLIGHT, Readings, Viewing
from manifold.model.estimator import Observation, explain
from manifold.pairs import cosine_weight
from manifold.records import Array, Bands, Mask

_SHOWN_ALTERNATIVES = 5
_NEAR_MIRROR_DEG = 5.0  # from a mirror direction, where readings measure all but the sharpest highlights
_DARK = 0.1  # share of the mean over readings, to which errors of darker ones are relative
_GLOSS_MISSED = 0.1  # relative error of cube roots above which gloss is not met
_UNEXPLAINED = 0.2  # residual of mixtures
_VISIBLE_NM = 550.0  # bands on both sides make a colour
_ALIKE = 0.1  # relative difference on a ball below which two mixtures are one alternative
_KEEP = 0.1  # weight of changes over all directions against residuals at readings
_FEW = (
    12.0  # sum of the weights of readings, cosines included, up to which that holds; more readings weigh more
)
_FEW_BANDS = 3  # bands, other than blue, green and red, that are no colour


@dataclass(frozen=True)
class Alternative:
    """A mixture of materials that explains the readings.

    Attributes:
        like: names of its materials, and their weights.
        probability: of it and of mixtures that look alike.
        misfit: relative error of the mean over bands at the readings, before they are adjusted to these, of it and of
            those that look alike: root mean square.
        difference: relative difference from the completion, in cube roots on the ball.
    """

    like: tuple[tuple[str, float], ...]
    probability: float
    misfit: float
    difference: float


@dataclass(frozen=True, eq=False, repr=False)
class Completion:
    """A material completed from readings.

    Attributes:
        atoms: of the library.
        readings: in the bands that were compared.
        at_readings: cube roots of atoms there, shape (n + 1, P).
        hypotheses: mixtures of materials, and their probabilities.
        weights: of atoms in the bands of the completion, see `bands_of`, shape (B, n + 1).
        residual: factors near the readings, in these bands.
        predicted: f at the readings, in 1/sr, shape (P, B_r).
        gloss_misfits: relative error of cube roots at the readings of gloss, by angle in degrees.
        written: the file's BRDF, of which these errors are; None where they are of the completion itself.
    """

    atoms: LibraryAtoms
    readings: Readings
    at_readings: Array
    hypotheses: Hypotheses
    weights: Array
    residual: ResidualFactors
    predicted: Array
    gloss_misfits: Mapping[float, float]
    written: BRDF | None = None

    @classmethod
    def of(cls, atoms: LibraryAtoms, readings: Readings, at: tuple[Array, Array] | None = None) -> Completion:
        """Complete readings of a material to all directions, with the materials of a library as prior.

        Args:
            atoms: of the library.
            readings: at P direction pairs, and G of gloss.
            at: cube roots of atoms at these, shapes (n, P) and (n, G), where they are known and the readings are in
                the bands of the library.

        Raises:
            BandMismatchError: the bands of readings and library do not go together.
            UsageError: no reading is left, or all are zero.
        """
        if at is None:
            readings = _usable(for_library(readings, atoms.bands))
            at = atoms.at(readings.wi, readings.wo), atoms.gloss(tuple(readings.gloss))
        at_readings, at_gloss = at
        where = coordinates(readings.wi, readings.wo)
        weights = readings.weights * cosine_weight(readings.wi, readings.wo) ** (2.0 / 3.0)
        read = ReadingRoots(at_readings, np.cbrt(np.maximum(readings.values, 0.0)).T, weights, where)
        gloss = GlossReadings.of(readings, at_gloss)
        all_where, ones = np.vstack([where, gloss.where]), np.ones(len(gloss.roots))
        of_mean = ReadingRoots(
            np.hstack([at_readings, gloss.atoms]), np.append(_mean_roots(readings), gloss.roots)[None],
            np.append(weights, ones), all_where,
        )  # fmt: skip
        mixtures = posterior(of_mean, atoms.gram, atoms.material_of, len(atoms.names))
        hypotheses = band_mixtures(mixtures, read, atoms.gram, atoms.material_of, gloss, len(atoms.names))
        combined = completion_weights(read, atoms.gram, hypotheses.mean, atoms.usable(hypotheses.mean))
        mixed, glossy = combined @ at_readings, combined @ gloss.atoms
        residual = residual_factors(
            np.hstack([read.material, gloss.scaled(glossy)]), np.hstack([mixed, glossy]), all_where,
            np.append(readings.weights, ones), readings.repeatability,
        )  # fmt: skip
        differences = gloss.differences(glossy)
        in_library = replace(residual, strength=in_all_bands(residual.strength, readings, atoms.bands))
        return cls(
            atoms, readings, at_readings, hypotheses, in_all_bands(combined, readings, atoms.bands), in_library,
            (mixed * residual.at(where)).T ** 3, dict(zip(readings.gloss, differences.tolist(), strict=True)),
        )  # fmt: skip

    def as_written(self, brdf: BRDF) -> Completion:
        """Return the completion with the errors of a file that it was written to."""
        f, read, nm = (
            brdf.eval(self.readings.wi, self.readings.wo),
            self.readings.gloss,
            self.readings.wavelengths_nm,
        )
        if nm is not None:
            f = np.array([np.interp(nm, np.array(brdf.bands.wavelengths_nm), row) for row in f])
        made = gloss_units(brdf, read)
        off = gloss_differences(np.array(list(made.values())), np.array(list(read.values())))
        return replace(
            self, predicted=f, written=brdf, gloss_misfits=dict(zip(read, off.tolist(), strict=True))
        )

    def __repr__(self) -> str:
        like = ", ".join(f"{weight:.2f} {name}" for name, weight in self.made_of)
        return f"<Completion: {self.readings.name} from {len(self.readings)} readings, {like}>"

    @property
    def bands(self) -> Bands:
        """The spectral axis of the completion."""
        return bands_of(self.readings, self.atoms.bands)

    @cached_property
    def brdf(self) -> AdjustedBRDF:
        """The completed BRDF, never negative."""
        return AdjustedBRDF(self.atoms.predicted(self.weights, self.bands), self.residual)

    @cached_property
    def on_grid(self) -> Array:
        """Values f at the encoding grid, shape (P_g, B)."""
        return self._at(self.atoms.directions[:, : self.atoms.n_grid], grid_coordinates())

    @cached_property
    def on_ball(self) -> Array:
        """Values f at all pairs that light a ball, shape (P_b, B)."""
        return self._at(self.atoms.ball, ball_coordinates())

    def _at(self, roots: Array, where: Array) -> Array:
        """Return f at coordinates (P, 3), at which atoms have cube roots (n + 1, P)."""
        return np.asarray((self.weights @ roots * self.residual.at(where)).T ** 3)

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions about the file, and bands and directions without readings, in sentences."""
        notes = list(self.readings.notes)
        reach = beyond(self.readings, self.atoms.bands)
        if reach is not None and reach[0] == reach[1]:
            notes.append(
                f"read at {reach[0]:g} nm only, which does not determine colours: the result is the same in all bands, "
                f"and the expected errors are those of coloured materials taken as grey"
            )
        elif reach is not None:
            notes.append(
                f"extrapolated below {reach[0]:g} nm and above {reach[1]:g} nm with the weights at these bands"
            )
        wi, wo = self.readings.wi, self.readings.wo
        from_mirror = np.rad2deg(np.arccos(np.clip(np.sum(wi * wo * [-1.0, -1.0, 1.0], axis=1), -1.0, 1.0)))
        if from_mirror.min() > _NEAR_MIRROR_DEG and not self.readings.gloss:
            notes.append(
                f"no reading within {from_mirror.min():.0f} degrees of a mirror direction: sharper highlights, "
                f"such as those of mirrors and clear coats, are not measured, and expected errors do not include "
                f"them; give their gloss, or measure such a direction"
            )
        notes += [
            f"gloss at {angle:g} degrees is not reproduced: {self.gloss[angle]:.3g} units, "
            f"{self.readings.gloss[angle]:.3g} read; no combination reproduces both it and the readings"
            for angle, misfit in self.gloss_misfits.items()
            if misfit > _GLOSS_MISSED
        ]
        if self.residual_of_mixtures > _UNEXPLAINED:
            notes.append(
                f"no mixture of two materials explains the readings (residual {100.0 * self.residual_of_mixtures:.0f} "
                f"% before the combination is adjusted to them, {100.0 * self.residual_of_readings:.1f} % "
                "after): the result follows them, and other directions are uncertain"
            )
        return tuple(notes)

    @cached_property
    def gloss(self) -> dict[float, float]:
        """Gloss units of the completion, by angle in degrees."""
        return gloss_units(self.written or self.brdf)

    @cached_property
    def misfits(self) -> Array:
        """Relative error of cube roots at every reading over its bands, of dark ones to a tenth of the mean, (P,).

        What repeated readings scatter is part of it.
        """
        is_read = self.readings.measured
        read = np.cbrt(np.maximum(np.where(is_read, self.readings.values, 0.0), 0.0))
        wrong = np.where(is_read, np.cbrt(self.predicted) - read, 0.0)
        norm = np.linalg.norm(read, axis=1)
        relative = np.linalg.norm(wrong, axis=1) / np.maximum(norm, _DARK * norm.mean())
        return np.hypot(relative, self.readings.scatter)

    @cached_property
    def colour_misfits(self) -> Array | None:
        """CIEDE2000 (see `viewing`) between every reading and the completion there, (P,); None without colours."""
        return None if self.colours is None else delta_e_2000_lab(*self.colours)

    @property
    def viewing(self) -> Viewing:
        """Light and observer of `colours`."""
        return DAYLIGHT if self.readings.bands.is_rgb else self.readings.viewing

    @cached_property
    def colours(self) -> tuple[Array, Array] | None:
        """CIELAB of the readings and of the completion there, see `viewing`, (P, 3) each; None without colours."""
        bands = self.readings.bands
        if bands.count < 3 or ((nm := bands.wavelengths_nm) is not None and not nm[0] < _VISIBLE_NM < nm[-1]):
            return None
        read = np.maximum(np.where(self.readings.measured, self.readings.values, self.predicted), 0.0)
        return lab_values(read, bands, self.viewing), lab_values(self.predicted, bands, self.viewing)

    @cached_property
    def residual_of_readings(self) -> float:
        """Root mean square of the relative errors of readings, or that of gloss if it is larger."""
        return max(float(np.sqrt(np.mean(self.misfits**2))), *self.gloss_misfits.values(), 0.0)

    @cached_property
    def colour_error(self) -> float:
        """Expected CIEDE2000 of spectra that were estimated, and of the lightness of readings that were repeated."""
        reflectance = np.clip(np.pi * np.nanmean(self.readings.values, axis=1), 0.0, 1.0)
        lightness = 116.0 * np.cbrt(reflectance) * self.readings.scatter  # CIELAB: 116 cbrt(Y) - 16
        return float(np.hypot(self.readings.colour_error, np.sqrt(np.mean(lightness**2))))

    @cached_property
    def residual_of_mixtures(self) -> float:
        """Relative error of the mean over bands at the readings, of mixtures before they are adjusted to them."""
        return float(np.sqrt(self.hypotheses.probability @ self._squared_misfits))

    @cached_property
    def _squared_misfits(self) -> Array:
        """Squared relative errors of the mean over bands at the readings, of every hypothesis, (H,)."""
        read = _mean_roots(self.readings)
        wrong = np.sum((self.hypotheses.weights @ self.at_readings - read) ** 2, axis=1)
        return np.asarray(wrong / (read @ read))

    @cached_property
    def spread(self) -> float:
        """Standard deviation of hypotheses over all directions and the ball, relative to their mean, in cube roots."""
        return self.hypotheses.spread(self.hypotheses.weights @ self.atoms.directions, self.atoms.weights)

    def spread_at(self, wi: Array, wo: Array) -> Array:
        """Return the relative standard deviation of hypotheses about f at direction pairs (P, 3), shape (P,)."""
        probability, weights = self.hypotheses.probability, self.hypotheses.weights
        curves = (weights @ self.atoms.at(wi, wo)) ** 3
        mean = probability @ curves
        variance = probability @ (curves - mean) ** 2
        return np.sqrt(variance) / np.maximum(mean, np.finfo(float).tiny)

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Hypotheses that look different from each other on the ball, most probable first."""
        probability, weights = self.hypotheses.probability, self.hypotheses.weights
        on_ball = slice(self.atoms.n_grid, None)
        curves = weights @ self.atoms.directions[:, on_ball]
        importance = self.atoms.weights[on_ball]
        mean = probability @ curves
        norm = max(float(mean**2 @ importance), np.finfo(float).tiny)
        squares = self._squared_misfits
        heads: list[int] = []
        totals: list[float] = []
        wrong: list[float] = []
        for h, curve in enumerate(curves):
            apart = [float((curve - curves[k]) ** 2 @ importance) / norm for k in heads]
            if not apart or min(apart) >= _ALIKE**2:
                heads.append(h)
                totals.append(0.0)
                wrong.append(0.0)
            like = int(np.argmin(apart)) if len(apart) == len(heads) else -1
            totals[like] += float(probability[h])
            wrong[like] += float(probability[h] * squares[h])
        order = np.argsort(totals)[::-1][:_SHOWN_ALTERNATIVES]
        return tuple(
            Alternative(
                self._materials(weights[heads[k]]),
                totals[k],
                float(np.sqrt(wrong[k] / max(totals[k], np.finfo(float).tiny))),
                float(np.sqrt((curves[heads[k]] - mean) ** 2 @ importance / norm)),
            )
            for k in order
        )

    @property
    def made_of(self) -> tuple[tuple[str, float], ...]:
        """The materials of the completion and their shares, largest first."""
        return self._materials(self.weights.mean(axis=0))

    def _materials(self, weights: Array) -> tuple[tuple[str, float], ...]:
        names = (*self.atoms.names, *self.atoms.coats, "Lambertian")
        totals: Array = np.bincount(self.atoms.material_of, weights, len(names)).astype(np.float64)
        return shown_shares(names, totals)


def completion_weights(read: ReadingRoots, gram: Array, prior: Array, usable: Mask | None = None) -> Array:
    """Return weights v >= 0 of atoms in every band that fit the readings and stay near prior weights: (B, n + 1).

    They minimise `sum_p w (v g - t)^2 / |t|^2 + keep (v - s) G (v - s)`: cube roots g of atoms and t of the material at
    readings of weights w, prior s (B, n + 1), and G (n + 1, n + 1), inner products of atoms averaged over all
    directions; only of atoms that are usable (n + 1,).
    """
    is_read = np.isfinite(read.material)
    known = np.where(is_read, read.material, 0.0)
    norm = float(np.sum(read.weights * known**2)) / len(known)
    if norm == 0.0:
        return np.zeros(prior.shape)
    gain = max(float(read.weights.sum()), 1.0) / _FEW
    kept = _KEEP * gram * (read.weights.sum() / norm)
    bands = [
        Observation(read.atoms, row, gain * read.weights * mask / norm, np.zeros(len(row), bool), True)
        for row, mask in zip(known, is_read, strict=True)
    ]
    return explain(bands, [kept] * len(bands), prior, usable)


def _usable(readings: Readings) -> Readings:
    """Return the measured readings of positive weight above the horizon."""
    is_usable = (readings.wi[:, 2] > 1e-3) & (readings.wo[:, 2] > 1e-3)
    is_usable &= readings.measured.any(axis=1) & (readings.weights > 0.0)
    if not np.nansum(np.maximum(readings.values[is_usable], 0.0)) > 0.0:
        raise UsageError(
            f"{readings.name}: none of {len(readings)} readings is above zero and above the horizon, expected "
            "one or more"
        )
    return readings.select_pairs(is_usable)


def _mean_roots(readings: Readings) -> Array:
    """Return cube roots of the mean over bands at every reading, shape (P,)."""
    mean = np.nanmean(np.maximum(readings.values, 0.0), axis=1)
    return np.asarray(np.cbrt(np.maximum(mean, 0.0)))


def for_library(readings: Readings, bands: Bands) -> Readings:
    """Return readings that a library of some bands can complete: linear sRGB for an RGB library, spectra for any.

    Three narrow bands become spectra, see `colour.narrow_bands`.
    """
    readings = with_spectra(readings)
    nm = readings.wavelengths_nm
    if not bands.is_rgb and nm is None:
        raise BandMismatchError(
            f"{readings.name}: readings in linear sRGB, expected wavelengths for a library of {bands}; complete "
            "them with an RGB library"
        )
    if bands.is_rgb and nm is not None and len(nm) <= _FEW_BANDS:
        raise BandMismatchError(
            f"{readings.name}: {readings.bands}, expected blue, green and red, or a spectrum, for an RGB library; "
            "complete them with a spectral one"
        )
    return readings


def bands_of(readings: Readings, bands: Bands) -> Bands:
    """Return the bands of a completion: those of the library, or of the spectra that an RGB library completes."""
    return readings.bands if bands.is_rgb else bands


def in_channels(readings: Readings, responses: Array) -> Readings:
    """Return spectra as a camera of some responses (3, B) to their bands sees them; RGB readings as they are."""
    nm = readings.wavelengths_nm
    if nm is None:
        return readings
    values = without_gaps(readings.values, nm) @ responses.T
    return replace(readings, wavelengths_nm=None, values=values, viewing=DAYLIGHT)


def without_gaps(values: Array, nm: Array) -> Array:
    """Interpolate gaps between measured bands of spectra (P, B); unmeasured ends stay NaN."""
    filled = values.copy()
    for row in filled:
        known = np.isfinite(row)
        if known.any():
            row[~known] = np.interp(nm[~known], nm[known], row[known], left=np.nan, right=np.nan)
    return filled


def in_all_bands(weights: Array, readings: Readings, bands: Bands) -> Array:
    """Interpolate weights (B_r, n) at the bands of readings to all B bands of a library; constant outside."""
    if bands.wavelengths_nm is None or readings.wavelengths_nm is None:
        return weights
    used = np.flatnonzero(weights.any(axis=0))
    spread = np.zeros((bands.count, weights.shape[1]))
    at = np.array(bands.wavelengths_nm)
    for k in used:
        spread[:, k] = np.interp(at, readings.wavelengths_nm, weights[:, k])
    return spread


def beyond(readings: Readings, bands: Bands) -> tuple[float, float] | None:
    """Return the first and last wavelength of the readings in nm if the library's range is larger; else None."""
    nm, of_library = readings.wavelengths_nm, bands.wavelengths_nm
    if nm is None or of_library is None:
        return None
    low, high = float(nm[0]), float(nm[-1])
    return (low, high) if of_library[0] < low - 1.0 or of_library[-1] > high + 1.0 else None
