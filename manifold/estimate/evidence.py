"""Combines observations of a material by instruments, gloss meters and cameras in the bands where they are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from manifold.colour.conversion import luminance
from manifold.colour.narrow_bands import interpolation_note, is_coarse, with_spectra
from manifold.core.errors import BandMismatchError, UsageError
from manifold.core.names import counted
from manifold.core.pairs import cosine_weight
from manifold.core.records import Array, Bands, Indices, Mask
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.gloss import value_of_unit
from manifold.estimate.mixtures import NOISE
from manifold.estimate.pixel_mixtures import INDEPENDENT, MODEL_ERROR
from manifold.formats.readings import MOST_GLOSS, NO_GLOSS, GlossUnits, Readings
from manifold.model.estimator import Observation

_READING = (MODEL_ERROR / NOISE) ** 2 / INDEPENDENT  # weight of a reading, of that of a picture
_CHANNELS_NM = (610.0, 550.0, 465.0)  # bands that stand for the channels of left-out materials
_FEW_BANDS = 3  # bands, other than blue, green and red, that are no colour


@dataclass(frozen=True, eq=False)
class Evidence:
    """Observations of a material, and the values of the atoms there.

    Without pictures, readings are compared in cube roots and in their own bands. Pictures measure sums of light; if
    there are any, readings and gloss are compared in values and in the channels of the camera, as further rows.

    Attributes:
        readings: readings of instruments; None without any.
        gloss: gloss units by angle in degrees.
        at: cube roots of atoms at the readings, (n, P), and at the gloss, (n, G); None if there are pictures.
        pictures: rows (pixels) of every picture in each of C channels, with the exposure of the picture.
        exposure: ratio of the pictures' values to those that light and material predict; None if unknown.
        each: whether every picture has its own exposure, which varies about the common one.
        of_readings: rows of the readings in each channel; empty without pictures.
        of_gloss: rows of the gloss in each channel; empty without pictures.
        to_bands: matrix from the channels to the bands of the completion, shape (B, C); None without pictures.
        strength: strength of clipped spots of the light, see `solving.strength_of_spots`; 0 without any.
        unlit: sentences about properties that the light of the pictures does not determine.
    """

    readings: Readings | None = None
    gloss: GlossUnits = field(default_factory=lambda: NO_GLOSS)
    at: tuple[Array, Array] | None = None
    pictures: Sequence[Sequence[Observation]] = ()
    exposure: float | None = 1.0
    each: bool = False
    of_readings: Sequence[Observation] = ()
    of_gloss: Sequence[Observation] = ()
    to_bands: Array | None = None
    strength: float = 0.0
    unlit: tuple[str, ...] = ()

    @classmethod
    def of_instruments(
        cls, atoms: LibraryAtoms, readings: Readings, at: tuple[Array, Array] | None = None
    ) -> Evidence:
        """Return readings, and the gloss stored with them, as evidence.

        `at` are the cube roots of the atoms at the readings (n, P) and the gloss (n, G); None evaluates them.
        """
        if at is None:
            at = atoms.at(readings.wi, readings.wo), atoms.at_gloss_meters(tuple(readings.gloss))
        return cls(readings, readings.gloss, at)

    def __str__(self) -> str:
        """Return a text that counts the pictures and readings and names the gloss."""
        parts = [counted(len(self.pictures), "picture")] if self.pictures else []
        if self.readings is not None:
            parts.insert(0, counted(len(self.readings), "reading"))
        name = "" if self.readings is None else f"{self.readings.name} from "
        return name + " and ".join(parts) + " and gloss" * bool(self.gloss)

    @property
    def read(self) -> tuple[Readings, Array, Array]:
        """The readings, and the cube roots of the atoms at them and at the gloss; only without pictures."""
        assert self.readings is not None
        assert self.at is not None
        return self.readings, *self.at

    @property
    def has_gains(self) -> bool:
        """Whether the relative exposures of the pictures must be estimated."""
        return self.each and len(self.pictures) > 1

    def under(self, exposures: Array, noise: Array | None = None) -> list[Observation]:
        """Return the observations of every channel, given the exposures (P,) of the pictures.

        Pictures with more noise (P,) than usual get smaller weights.
        """
        counts = np.ones(len(exposures)) if noise is None else (MODEL_ERROR / noise) ** 2
        channels = []
        for c in range(len(self.pictures[0])):
            parts = [
                replace(picture[c].scaled(exposure), weights=count * picture[c].weights)
                for picture, exposure, count in zip(
                    self.pictures, exposures.tolist(), counts.tolist(), strict=True
                )
            ]
            rows = Observation.joined(parts)
            for others in (self.of_readings, self.of_gloss):
                rows = rows.beside(others[c]) if others else rows
            channels.append(rows)
        return channels

    def exposed(self, exposures: Array) -> Evidence:
        """Return the evidence with pictures divided by exposures (P,); an unknown exposure stays unknown."""
        pictures = [
            [rows.scaled(exposure) for rows in picture]
            for picture, exposure in zip(self.pictures, exposures.tolist(), strict=True)
        ]
        return replace(self, pictures=pictures, exposure=None if self.exposure is None else 1.0)

    def of_material(self, atoms: LibraryAtoms, m: int) -> Evidence:
        """Return the observations that the same instruments and cameras would make of material m, without noise.

        Readings of it are simulated only in the atom bands nearest to bands of the real readings, so that the errors
        of extrapolating to other bands are included.
        """
        if self.pictures:
            return self._pictures_of(channel_atoms(atoms, m))
        (readings, at, glossy), own, axis = self.read, atoms.material_of == m, atoms.band_axis
        is_read = nearest_bands(axis, readings.bands)
        gloss = {
            angle: min(float(mean) / value_of_unit(angle), MOST_GLOSS[angle])
            for angle, mean in zip(self.gloss, luminance(glossy[own].T ** 3, axis), strict=True)
        }
        read = Readings(
            atoms.names[m], "library", readings.wi, readings.wo,
            None if axis.wavelengths_nm is None else np.array(axis.wavelengths_nm)[is_read],
            at[own].T[:, is_read] ** 3, readings.weights, gloss=gloss, repeatability=readings.repeatability,
        )  # fmt: skip
        return replace(self, readings=read, gloss=gloss)

    def _pictures_of(self, own: Indices) -> Evidence:
        """Return pictures, and readings and gloss beside them, of atoms `own`, one for each channel."""
        pictures = [
            [seen_instead(rows, rows.atoms[k]) for rows, k in zip(picture, own, strict=True)]
            for picture in self.pictures
        ]
        of_readings, of_gloss = (
            [replace(rows, seen=rows.atoms[k]) for rows, k in zip(others, own, strict=True)] if others else []
            for others in (self.of_readings, self.of_gloss)
        )
        return replace(self, pictures=pictures, of_readings=of_readings, of_gloss=of_gloss)


def channel_atoms(atoms: LibraryAtoms, material: int) -> Indices:
    """Return the three atoms of a material of the library that correspond to the channels of a camera."""
    axis = atoms.band_axis
    nm = axis.wavelengths_nm
    if nm is None:
        return material * axis.count + np.arange(3)
    return material * axis.count + np.array([np.abs(np.subtract(nm, at)).argmin() for at in _CHANNELS_NM])


def seen_instead(rows: Observation, seen: Array) -> Observation:
    """Return the observations with the pixels of another material, clipped at the same level."""
    level = clipping(rows)
    is_bound = (seen >= level) & (np.arange(len(seen)) < len(seen) - rows.n_beside)
    return replace(rows, seen=np.where(is_bound, level, seen), is_bound=is_bound)


def clipping(rows: Observation) -> float:
    """Return the value at which the camera clipped pixels."""
    return float(rows.seen[rows.is_bound].min()) if rows.is_bound.any() else np.inf


def rows_of_readings(atoms: LibraryAtoms, readings: Readings, of_pixels: float) -> list[Observation]:
    """Return readings as observations in the channels of a camera.

    The observed values are reflectance factors times a cosine, like pixels; values brighter than white are scaled to
    white. On average, a reading has the share `_READING` of the total weight of a picture's pixels, `of_pixels`.
    """
    channels = []
    for values in readings.values.T:
        is_read = np.isfinite(values) & (readings.weights > 0.0)
        wi, wo = readings.wi[is_read], readings.wo[is_read]
        weights = readings.weights[is_read]
        weights = weights * of_pixels * _READING / max(weights.mean(), np.finfo(float).tiny)
        seen = np.maximum(values[is_read], 0.0)
        scale = cosine_weight(wi, wo) * np.pi
        scale /= np.maximum(scale * seen, 1.0)
        channels.append(Observation(atoms.at(wi, wo) * scale, seen * scale, weights, np.zeros(len(wi), bool)))
    return channels


def rows_of_gloss(
    atoms: LibraryAtoms, gloss: GlossUnits, weights: Array, of_pixel: float
) -> list[Observation]:
    """Return gloss values as observations in every camera channel.

    The weights (3, n) of the atoms predict their colour. Each observation has the weight of one pixel, `of_pixel`.
    """
    means, unit = atoms.at_gloss_meters(tuple(gloss)), np.array([value_of_unit(angle) for angle in gloss])
    read = unit * list(gloss.values())
    of_channels = np.maximum(weights @ means, np.finfo(float).tiny)
    seen = read * of_channels / luminance(of_channels.T, Bands(None))
    counts = np.full(len(read), of_pixel)
    scale = 1.0 / np.maximum(seen, unit)
    return [
        Observation(means * k, row * k, counts, np.zeros(len(row), bool))
        for row, k in zip(seen, scale, strict=True)
    ]


def usable_readings(readings: Readings) -> Readings:
    """Return the readings that were measured, are above the horizon, and have a positive weight."""
    is_usable = (readings.wi[:, 2] > 1e-3) & (readings.wo[:, 2] > 1e-3)
    is_usable &= readings.measured.any(axis=1) & (readings.weights > 0.0)
    if not np.nansum(np.maximum(readings.values[is_usable], 0.0)) > 0.0:
        raise UsageError(
            f"{readings.name}: none of {len(readings)} readings is above zero and above the horizon, expected "
            "one or more"
        )
    return readings.select_pairs(is_usable)


def for_library(readings: Readings, bands: Bands) -> Readings:
    """Return readings in a form that a library with these bands can complete.

    Linear sRGB needs an RGB library; spectra fit any library. Three narrow bands are converted to spectra, see
    `colour.narrow_bands`.
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
            "complete them with a spectral one (manifold fetch && manifold import rgl)"
        )
    if bands.is_rgb and is_coarse(readings.bands):
        return readings.with_note(interpolation_note(readings.bands))
    return readings


def bands_of(readings: Readings, bands: Bands) -> Bands:
    """Return the bands of a completion: those of the library or, if the library is RGB, those of the readings."""
    return readings.bands if bands.is_rgb else bands


def in_all_bands(weights: Array, readings: Readings, bands: Bands) -> Array:
    """Interpolate weights (B_r, n) at the bands of readings to all B bands of a library; they are constant outside."""
    if bands.wavelengths_nm is None or readings.wavelengths_nm is None:
        return weights
    used = np.flatnonzero(weights.any(axis=0))
    spread = np.zeros((bands.count, weights.shape[1]))
    at = np.array(bands.wavelengths_nm)
    for k in used:
        spread[:, k] = np.interp(at, readings.wavelengths_nm, weights[:, k])
    return spread


def beyond(readings: Readings, bands: Bands) -> tuple[float, float] | None:
    """Return the first and last wavelength of the readings in nm if the library's range is larger, otherwise None."""
    nm, of_library = readings.wavelengths_nm, bands.wavelengths_nm
    if nm is None or of_library is None:
        return None
    low, high = float(nm[0]), float(nm[-1])
    return (low, high) if of_library[0] < low - 1.0 or of_library[-1] > high + 1.0 else None


def nearest_bands(bands: Bands, to: Bands) -> Mask:
    """Return a mask of the bands (B,) that are nearest to a band of `to`; all bands if either is linear sRGB."""
    if bands.wavelengths_nm is None or to.wavelengths_nm is None:
        return np.ones(bands.count, bool)
    apart = np.abs(np.subtract.outer(to.wavelengths_nm, bands.wavelengths_nm))
    return np.isin(np.arange(bands.count), apart.argmin(axis=1))
