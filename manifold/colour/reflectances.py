"""Provides reflectance spectra by name, from files, and of a given colour, and refractive indices of metals."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from importlib.machinery import PathFinder
from pathlib import Path

import numpy as np

from manifold.colour.colour_science import colour_science, distribution, frozen
from manifold.colour.conversion import decode_srgb, sensor_responses, to_srgb, xyz_to_srgb
from manifold.colour.illuminants import Illuminant
from manifold.core.directions import from_spherical
from manifold.core.errors import FileFormatError, ShapeError, UnknownNameError, UsageError
from manifold.core.names import names_like
from manifold.core.records import Array, Bands
from manifold.formats.spectra import read_spectrum

BEYOND_COLOURS = 0.15
"""Share of a colour's norm by which it may lie beyond the colours of reflectances; fluorescent paints reach 0.14."""
_VISIBLE_NM = (400.0, 700.0)
_MOST_NOISY = 1.5  # larger values are no noise of a white: per cent, or codes
_ALL_BUT_BLACK = 0.01  # largest reflectance of a spectrum that is doubted: only special blacks are darker
_LARGEST_GAP_NM = 100.0  # between wavelengths, without a note
_UNEVEN = 3.0  # least ratio of a gap that is noted to the usual one
_NORMALS = 1000  # of the solid of colours
_LEAST_NORM = 0.01  # darker colours are compared with this norm, because their readings are uncertain


def diffuse_reflectance_names() -> tuple[str, ...]:
    """Return the names of all spectra of `diffuse_reflectance`, as `set/name`.

    The sets are `ohta`, `babel` and `iso17321` (the 24 patches of a ColorChecker, three measurements), `pmc` (skin,
    fruit, grass and other objects of daily life), `tcs` (CIE test colour samples), `vs` (NIST colour
    quality samples).
    """
    return tuple(_reflectances())


def diffuse_reflectance(name: str, wavelengths_nm: Array) -> Array:
    """Return a measured diffuse reflectance by its name, in [0, 1], in the shape of `wavelengths_nm`.

    The spectrum is interpolated linearly and constant outside the measured range, which is 380 to 730 nm (`babel`),
    380 to 780 (`ohta`, `iso17321`), 400 to 700 (`pmc`), or 360 to 830 (`tcs`, `vs`): the ultraviolet and infrared
    bands of RGL files are continuations, not measurements. A name is one of `diffuse_reflectance_names()`, or its
    part after the slash, which means the first set that has it (`dark skin` is `ohta/dark skin`).
    Source: colour-science's `SDS_COLOURCHECKERS`, `SDS_TCS`, `SDS_VS`.
    """
    known = _reflectances()
    key = name if name in known else next((k for k in known if k.split("/", 1)[1] == name), None)
    if key is None:
        plain = [k.split("/", 1)[1] for k in known]
        raise UnknownNameError(
            f"no reflectance named {name!r}; {names_like([*known, *plain], name, 'the names are')}"
        )
    return np.clip(np.interp(wavelengths_nm, *known[key]), 0.0, 1.0)


def beyond_reflectances(linear: Array) -> Array:
    """Return how far colours lie beyond those of reflectances from 0 to 1 under D65, as shares of their norms.

    Colours are linear sRGB (..., 3); the result (...) is negative for colours that a reflectance has.
    """
    normals, extent = _solid_of_reflectances()
    return np.max(linear @ normals.T - extent, axis=-1) / np.maximum(
        np.linalg.norm(linear, axis=-1), _LEAST_NORM
    )


@lru_cache(maxsize=1)
def _solid_of_reflectances() -> tuple[Array, Array]:
    """Return normals (K, 3) of the solid of all reflectances from 0 to 1 under D65 in linear sRGB, and its extents.

    Source: Schroedinger 1920; the extent is reached by a reflectance of 1 where the normal's response is positive.
    """
    _, responses = sensor_responses(Illuminant.named("D65"), 2)
    k = np.arange(_NORMALS) + 0.5  # a Fibonacci lattice
    normals = from_spherical(np.arccos(1.0 - 2.0 * k / _NORMALS), np.pi * (1.0 + 5.0**0.5) * k)
    return frozen(normals), frozen(np.maximum(normals @ xyz_to_srgb(responses).T, 0.0).sum(axis=1))


def srgb_reflectance(display: Array, bands: Bands) -> Array:
    """Return a smooth reflectance with a given sRGB colour under D65, in [0, 1], shape (B,).

    For RGB bands, return the linear colour itself.

    Args:
        display: encoded sRGB values in [0, 1], shape (3,).
        bands: the spectral axis.

    Raises:
        ShapeError: the colour is not three values in [0, 1].
    Source: see `srgb_spectra`.
    """
    try:
        display = np.asarray(display, dtype=np.float64)
    except (TypeError, ValueError):
        raise ShapeError(f"an sRGB colour is {display!r:.40}, expected three values from 0 to 1") from None
    if display.shape != (3,) or not np.all((display >= 0) & (display <= 1)):
        raise ShapeError(f"an sRGB colour is {display.tolist()}, expected three values from 0 to 1")
    linear = decode_srgb(display)
    return linear if bands.is_rgb else np.clip(linear @ srgb_spectra(bands), 0.0, 1.0)


@lru_cache(maxsize=8)
def srgb_spectra(bands: Bands) -> Array:
    """Return smooth spectra of the three linear sRGB primaries under D65, read-only, shape (3, B), B wavelengths.

    Their sum, weighted by a linear colour, is a spectrum of that colour. They are non-negative and sum to 1 in
    every band.

    Source: Mallett & Yuksel 2019; held constant outside 380 to 780 nm.
    """
    to_spectrum = colour_science().recovery.RGB_to_sd_Mallett2019
    at = np.asarray(bands.wavelengths_nm)
    primaries = [distribution(to_spectrum(primary)) for primary in np.eye(3)]
    return frozen(np.stack([np.interp(at, nm, values) for nm, values in primaries]))


class DoubtfulSpectrumWarning(UserWarning):
    """A reflectance spectrum probably has another scale, or lacks a part."""


@dataclass(frozen=True)
class ReflectanceSpectrum:
    """A reflectance spectrum, linear between its wavelengths and constant beyond them.

    Attributes:
        wavelengths_nm: increasing, at least two, which cover at least half of the visible range.
        values: reflectances from 0 to 1, one per wavelength.
    """

    wavelengths_nm: tuple[float, ...]
    values: tuple[float, ...]
    name: str = "spectrum"

    def __post_init__(self) -> None:
        nm, values = (np.asarray(a, dtype=np.float64) for a in (self.wavelengths_nm, self.values))
        if nm.ndim != 1 or nm.shape != values.shape or len(nm) < 2:
            raise UsageError(
                f"{self.name}: {nm.shape} wavelengths and {values.shape} reflectances, "
                "expected equal numbers, at least 2"
            )
        if not np.all(np.diff(nm) > 0) or not np.isfinite(nm[-1]):
            raise UsageError(
                f"{self.name}: wavelengths do not increase, expected different, finite ones in nm; sort them"
            )
        if not np.all((values >= 0) & (values <= 1)):
            remedy = (
                "divide percent by 100" if values.max() > _MOST_NOISY else "set noise beyond them to 0 or 1"
            )
            raise UsageError(
                f"{self.name}: reflectances from {values.min():g} to {values.max():g}, expected 0 to 1; {remedy}"
            )
        low, high = _VISIBLE_NM
        if min(nm[-1], high) - max(nm[0], low) < 0.5 * (high - low):
            raise UsageError(
                f"{self.name}: covers {nm[0]:g} to {nm[-1]:g} nm, expected most of {low:g} to {high:g} nm"
            )
        object.__setattr__(self, "wavelengths_nm", tuple(nm.tolist()))
        object.__setattr__(self, "values", tuple(values.tolist()))

    def in_bands(self, bands: Bands) -> Array:
        """Return the reflectance in bands, shape (B,); for RGB bands its linear sRGB colour under D65."""
        nm, values = np.array(self.wavelengths_nm), np.array(self.values)
        if bands.is_rgb:
            return np.clip(to_srgb(values, Bands(self.wavelengths_nm)), 0.0, 1.0)
        return np.asarray(np.interp(np.asarray(bands.wavelengths_nm), nm, values))


def read_reflectance(path: Path, bands: Bands) -> Array:
    """Read a reflectance spectrum from a file, interpolated to the bands, shape (B,).

    The file is read by `formats.spectra.read_spectrum`. Beyond its range the spectrum is constant. For RGB bands the
    result is its linear sRGB colour under D65.

    Raises:
        FileFormatError: the file holds no reflectances from 0 to 1, or covers less than half of the visible range.
        UsageError: the file cannot be read.
    """
    nm, values = read_spectrum(path, "reflectance")
    try:
        spectrum = ReflectanceSpectrum(tuple(nm.tolist()), tuple(values.tolist()), str(path))
    except UsageError as error:
        raise FileFormatError(str(error)) from error
    for doubt in _doubts(nm, values):
        warnings.warn(f"{path}: {doubt}", DoubtfulSpectrumWarning, stacklevel=2)
    return spectrum.in_bands(bands)


def _doubts(nm: Array, values: Array) -> list[str]:
    """Return sentences about a spectrum that is darker than materials are, or lacks a part of the visible range."""
    doubts = []
    if 0.0 < values.max() <= _ALL_BUT_BLACK:
        doubts.append(
            f"reflectances of at most {100.0 * values.max():.2g} %: if they are fractions, remove the percent sign"
        )
    seen = np.clip(nm, *_VISIBLE_NM)
    steps, k = np.diff(seen), int(np.argmax(np.diff(seen)))
    if steps[k] > max(_LARGEST_GAP_NM, _UNEVEN * float(np.median(np.diff(nm)))):
        doubts.append(f"no reflectances between {nm[k]:g} and {nm[k + 1]:g} nm, where they are interpolated")
    return doubts


@lru_cache(maxsize=1)
def _reflectances() -> dict[str, tuple[Array, Array]]:
    """Return all measured reflectances by `set/name`: wavelengths in nm and values."""
    colour = colour_science()
    from colour.quality.datasets import SDS_TCS, SDS_VS

    checkers = colour.SDS_COLOURCHECKERS
    sets = {
        "ohta": checkers["ColorChecker N Ohta"],
        "pmc": checkers["PMC"],
        "tcs": SDS_TCS["CIE 1995"],
        "vs": SDS_VS["NIST CQS 9.0"],
        "babel": checkers["BabelColor Average"],
        "iso17321": checkers["ISO 17321-1"],
    }
    return {f"{s}/{name}": distribution(t) for s, table in sets.items() for name, t in table.items()}


def metal_names() -> tuple[str, ...]:
    """Return the sorted names of all materials of `metal_ior`: symbols and formulas such as `Au`, `TiN`."""
    return tuple(sorted(_ior_files()))


def metal_ior(name: str, wavelengths_nm: Array) -> tuple[Array, Array]:
    """Return the complex index of refraction eta + i k of a metal or crystal, relative to vacuum.

    The table is interpolated linearly and constant beyond its ends. Most tables end between 750 and 900 nm, so the
    last infrared bands of RGL files repeat the end of the table.

    Args:
        name: one of `metal_names()`, such as `Au`.
        wavelengths_nm: wavelengths in nm, any shape.

    Returns:
        eta and k, both in the shape of `wavelengths_nm`.

    Raises:
        UsageError: there is no such table.
        FileFormatError: a table does not hold pairs of numbers.
    Source: the tables `data/ior/*.spd` of Mitsuba 3 (luxpop.com, SOPRA, Palik).

    >>> eta, k = metal_ior("Au", np.array([450.0, 650.0]))
    >>> eta.round(2), k.round(2)
    (array([1.51, 0.17]), array([1.88, 3.14]))
    """
    files = _ior_files()
    if name not in files:
        raise UsageError(f"no index of refraction named {name!r}; known: {', '.join(sorted(files))}")
    (eta_nm, eta), (k_nm, k) = (_read_spd(path) for path in files[name])
    known = eta > 0.0  # no medium has eta = 0: the tables of AlAs write it where a value is missing
    return np.interp(wavelengths_nm, eta_nm[known], eta[known]), np.interp(wavelengths_nm, k_nm, k)


@lru_cache(maxsize=1)
def _ior_files() -> dict[str, tuple[Path, Path]]:
    """Return the files of eta and k by material: our own, and Mitsuba's, which is located without an import."""
    # Past sys.modules: an imported mitsuba that has set a variant no longer says where it lies.
    spec = PathFinder.find_spec("mitsuba")
    folders = [Path(p) / "data" / "ior" for p in (spec.submodule_search_locations or [])] if spec else []
    folders.insert(0, Path(__file__).with_name("ior"))
    found = {
        path.name.removesuffix(".eta.spd"): (path, path.with_name(path.name.replace(".eta.", ".k.")))
        for folder in folders
        for path in folder.glob("*.eta.spd")
    }
    return {name: pair for name, pair in found.items() if pair[1].is_file()}


@lru_cache(maxsize=256)
def _read_spd(path: Path) -> tuple[Array, Array]:
    """Read wavelengths in nm, increasing, and values from a file of `wavelength value` lines."""
    try:
        table = np.loadtxt(path, comments="#", ndmin=2)
    except ValueError as error:
        raise FileFormatError(f"{path.name}: {error}; expected lines of `wavelength value`") from error
    if table.shape[1] != 2 or not np.all(np.diff(table[:, 0]) > 0):
        raise FileFormatError(f"{path.name}: expected two columns, wavelengths increasing; reinstall mitsuba")
    return frozen(table[:, 0].copy()), frozen(table[:, 1].copy())


NODES_NM = (460.0, 540.0, 605.0)
"""Wavelengths in nm at which blue, green or red has the full weight.

Between them the weight is shared linearly by two.
"""

_LEAST = 1e-3  # least change of a weight, so that spectra stay positive


def weights_at(wavelengths_nm: Array) -> Array:
    """Return the weights of red, green and blue at wavelengths, shape (W, 3).

    They are piecewise linear and sum to 1.
    """
    blue, green, red = (np.interp(wavelengths_nm, NODES_NM, row) for row in np.eye(3))
    return np.stack([red, green, blue], axis=-1)


def spectral_changes(ratios: Array, mean: Array, bands: Bands) -> Array:
    """Return the factors (..., 3) of the red, green and blue weights, above 0, that give points their colours.

    `ratios` (..., 3), above 0, are the linear sRGB colours of the points divided by that of the mean, whose spectrum
    is `mean` (B,). The spectrum of a point is the mean spectrum times `weights_at(wavelengths) @ changes`, which is
    smooth and never negative. Its linear sRGB has the given ratios, except for points so saturated that a factor
    would be negative. For RGB bands the factors equal the ratios.
    """
    if bands.is_rgb:
        return ratios
    weights = weights_at(np.asarray(bands.wavelengths_nm))
    mixing = np.stack([to_srgb(mean * weight, bands) for weight in weights.T], axis=-1)
    mixing /= to_srgb(mean, bands)[:, None]  # rows sum to 1
    return np.asarray(np.maximum(ratios @ np.linalg.inv(mixing).T, _LEAST))
