"""Spectra: measured indices of metals, measured reflectances, and the way from bands to colour.

Indices come from the tables that Mitsuba ships, reflectances, illuminants and colour-matching functions
from colour-science. Both are read on first use: importing this module costs nothing.
"""

from __future__ import annotations

import difflib
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType

import numpy as np

from manifold.errors import FileFormatError, ShapeError, UsageError
from manifold.records import Array, Bands

OBSERVER = "CIE 1931 2 Degree Standard Observer"
_MOST_POWER = 1e30  # renders are in single precision
_VISIBLE_NM = (400.0, 700.0)
"""The colour-matching functions behind XYZ and sRGB, by their name in colour-science."""

# CIE's names of the fluorescent illuminants, which colour-science calls FL1 to FL12.
_CIE_FLUORESCENT = {f"F{i}": f"FL{i}" for i in range(1, 13)}

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def rgl_wavelengths_nm() -> Array:
    """The 195 band centres of the RGL spectral files in nm, shape (195,): 358.63 to 1001.89, evenly spaced.

    Rounded to float32, as the files hold them, and returned as float64.
    """
    return np.linspace(358.63, 1001.89, 195).astype(np.float32).astype(np.float64)


def metal_names() -> tuple[str, ...]:
    """The materials `metal_ior` knows, sorted: element symbols and formulas such as `Au`, `Cr`, `TiN`."""
    return tuple(sorted(_ior_files()))


def metal_ior(name: str, wavelengths_nm: Array) -> tuple[Array, Array]:
    """Complex index of refraction eta + i k of a metal or crystal, relative to vacuum.

    Interpolated linearly between the table's wavelengths and held constant outside them: most tables end
    between 750 and 900 nm, so the last infrared bands of RGL files repeat the table's end.

    Args:
        name: one of `metal_names()`, such as `Au`.
        wavelengths_nm: wavelengths in nm, any shape.
    Returns:
        eta and k, both in the shape of `wavelengths_nm`.
    Raises:
        UsageError: there is no such table.
        FileFormatError: a table does not hold pairs of numbers.
    Source: the tables `data/ior/*.spd` of Mitsuba 3 (luxpop.com, SOPRA, Palik).
    """
    files = _ior_files()
    if name not in files:
        raise UsageError(f"no index of refraction named {name!r}; known: {', '.join(sorted(files))}")
    (eta_nm, eta), (k_nm, k) = (_read_spd(path) for path in files[name])
    known = eta > 0.0  # no medium has eta = 0: the tables of AlAs write it where a value is missing
    return _interpolate(wavelengths_nm, eta_nm[known], eta[known]), _interpolate(wavelengths_nm, k_nm, k)


def diffuse_reflectance_names() -> tuple[str, ...]:
    """The spectra `diffuse_reflectance` knows, as `set/name`.

    Sets: `ohta`, `babel` and `iso17321` (the 24 patches of a ColorChecker, three measurements), `pmc` (skin,
    fruit, grass and other objects of daily life), `tcs` (CIE test colour samples), `vs` (NIST colour
    quality samples).
    """
    return tuple(_reflectances())


def diffuse_reflectance(name: str, wavelengths_nm: Array) -> Array:
    """A measured diffuse reflectance, in [0, 1], in the shape of `wavelengths_nm`.

    Interpolated linearly and held constant outside the measured range, which is 380 to 730 nm (`babel`),
    380 to 780 (`ohta`, `iso17321`), 400 to 700 (`pmc`), or 360 to 830 (`tcs`, `vs`): the ultraviolet and
    infrared bands of RGL files are continuations, not measurements.

    Args:
        name: one of `diffuse_reflectance_names()`, or its part after the slash, which means the first set
            that has it (`dark skin` is `ohta/dark skin`).
        wavelengths_nm: wavelengths in nm, any shape.
    Raises:
        UsageError: there is no such spectrum.
    Source: colour-science's `SDS_COLOURCHECKERS`, `SDS_TCS`, `SDS_VS`.
    """
    known = _reflectances()
    key = name if name in known else next((k for k in known if k.split("/", 1)[1] == name), None)
    if key is None:
        plain = [k.split("/", 1)[1] for k in known]
        raise UsageError(f"no reflectance named {name!r}; {_near(name, [*known, *plain])}")
    return np.clip(_interpolate(wavelengths_nm, *known[key]), 0.0, 1.0)


def illuminant_names() -> tuple[str, ...]:
    """The illuminants `to_xyz` knows: those of colour-science, and CIE's F1 to F12 for its FL1 to FL12."""
    return (*_colour().SDS_ILLUMINANTS, *_CIE_FLUORESCENT)


def to_xyz(values: Array, bands: Bands, illuminant: str = "D65") -> Array:
    """CIE XYZ of reflectance-like spectra; a perfect diffuser has Y = 1 under every illuminant.

    The spectrum is taken as piecewise linear between the bands and constant beyond them, and integrated
    at 1 nm against the illuminant times the 2 degree observer of 1931. Linear sRGB values (RGB bands) carry
    no spectrum: they are converted by the sRGB matrix, and the illuminant is only checked to exist.

    Args:
        values: spectra, shape (..., B).
        bands: their B bands.
        illuminant: one of `illuminant_names()`.
    Returns:
        XYZ, shape (..., 3).
    Raises:
        UsageError: there is no such illuminant, or it gives no light where the observer sees.
        ShapeError: the last axis of `values` is not B.
    """
    return _require_bands(values, bands) @ xyz_weights(bands, illuminant)


def to_srgb(values: Array, bands: Bands, illuminant: str = "D65", *, adapt: bool = True) -> Array:
    """Linear sRGB (Rec. 709 primaries, not clipped) of reflectance-like spectra, shape (..., 3).

    With `adapt` the illuminant's white is adapted to D65 (Bradford), so a perfect diffuser is (1, 1, 1)
    under every illuminant, as it is for the eye; without it, things lit by illuminant A look orange. RGB
    bands are linear sRGB already and are returned as they are.

    Args, raises: as `to_xyz`.
    """
    values = _require_bands(values, bands)
    weights = xyz_weights(bands, illuminant)
    if bands.is_rgb:
        return values.copy()
    to_rgb = np.linalg.inv(_srgb_to_xyz())
    if adapt:
        to_rgb = to_rgb @ _adaptation(weights.sum(axis=0), _srgb_to_xyz().sum(axis=1))
    return values @ (weights @ to_rgb.T)


def encode_srgb(linear: Array) -> Array:
    """Linear sRGB in [0, 1], shape (..., 3), as display values in [0, 1] (IEC 61966-2-1)."""
    return np.asarray(_colour().models.eotf_inverse_sRGB(np.clip(linear, 0.0, 1.0)))


def srgb_reflectance(display: Array, bands: Bands) -> Array:
    """A smooth reflectance that looks like an sRGB colour under D65, in [0, 1], shape (B,).

    Of RGB bands, the linear colour itself.

    Args:
        display: encoded sRGB values in [0, 1], shape (3,).
        bands: the spectral axis.
    Raises:
        ShapeError: the colour is not three values in [0, 1].
    Source: Mallett & Yuksel 2019, whose three basis spectra sum to 1; held constant outside 380 to 780 nm.
    """
    display = np.asarray(display, dtype=np.float64)
    if display.shape != (3,) or not np.all((display >= 0) & (display <= 1)):
        raise ShapeError(f"an sRGB colour is {display.tolist()}, expected three values from 0 to 1")
    linear = np.asarray(_colour().models.eotf_sRGB(display), float)
    if bands.is_rgb:
        return linear
    nodes, values = _spectral_distribution(_colour().recovery.RGB_to_sd_Mallett2019(linear))
    return np.clip(np.interp(np.asarray(bands.wavelengths_nm), nodes, values), 0.0, 1.0)


def read_reflectance(path: Path, bands: Bands) -> Array:
    """A reflectance spectrum from a text file, interpolated to the bands, shape (B,).

    The file has two columns, wavelength in nm and reflectance from 0 to 1, separated by commas or blanks; lines
    before the first that holds numbers are skipped, and those that begin with #. Outside the file's range the ends
    are held. Of RGB bands: its linear sRGB colour under D65.

    Raises:
        FileFormatError: there are not two rows of two such numbers, wavelengths repeat, or less than half of what
            is visible is covered.
        UsageError: the file cannot be read.
    """
    nm, values = _read_columns(path, "reflectance")
    if values.min() < 0 or values.max() > 1:
        raise FileFormatError(
            f"{path}: reflectances from {values.min():g} to {values.max():g}, expected 0 to 1; divide percent by 100"
        )
    low, high = _VISIBLE_NM
    if min(nm[-1], high) - max(nm[0], low) < 0.5 * (high - low):
        raise FileFormatError(
            f"{path}: covers {nm[0]:g} to {nm[-1]:g} nm, expected most of {low:g} to {high:g} nm"
        )
    if bands.is_rgb:
        return np.clip(to_srgb(values, Bands(tuple(nm.tolist()))), 0.0, 1.0)
    return np.interp(np.asarray(bands.wavelengths_nm), nm, values)


def _read_columns(path: Path, what: str) -> tuple[Array, Array]:
    """Wavelengths in nm, increasing, and values of a text file of two columns."""
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise UsageError(
            f"{path}: {error.strerror}; expected a text file of wavelengths and {what}s"
        ) from error
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(lines, start=1):
        cells = _numbers(line)
        if cells is not None:
            rows.append(cells)
        elif rows and line.strip() and not line.lstrip().startswith("#"):
            raise FileFormatError(
                f"{path}: line {number} is '{line.strip()[:40]}', expected a wavelength in nm and a {what} "
                "with a decimal point"
            )
    if len(rows) < 2:
        raise FileFormatError(
            f"{path}: found {len(rows)} rows of wavelength and {what}, expected at least 2, with decimal points"
        )
    nm, values = np.array(sorted(rows)).T
    if np.any(np.diff(nm) <= 0) or not 100.0 <= nm[0] <= nm[-1] <= 10000.0:
        raise FileFormatError(
            f"{path}: wavelengths from {nm[0]:g} to {nm[-1]:g}, expected different ones in nm"
        )
    return nm, values


@dataclass(frozen=True)
class Illuminant:
    """The relative spectral power of a light.

    Attributes:
        name: of a CIE illuminant, or of the file it was read from.
        wavelengths_nm: increasing.
        power: one value per wavelength, linear between, 0 beyond.
    """

    name: str
    wavelengths_nm: tuple[float, ...]
    power: tuple[float, ...]

    @classmethod
    def named(cls, name: str) -> Illuminant:
        """One of `illuminant_names()`.

        Raises:
            UsageError: there is no such illuminant.
        """
        nodes, power = _spectral_distribution(_colour().SDS_ILLUMINANTS[_illuminant_key(name)])
        return cls(name, tuple(nodes.tolist()), tuple(power.tolist()))

    @classmethod
    def read(cls, path: Path) -> Illuminant:
        """A text file of two columns, wavelength in nm and power in any unit; laid out as in `read_reflectance`.

        Raises:
            FileFormatError: there are not two rows of two such numbers, wavelengths repeat, or power is negative.
            UsageError: the file cannot be read.
        """
        nm, power = _read_columns(path, "power")
        if power.min() < 0 or not 0 < power.max() < _MOST_POWER:
            raise FileFormatError(
                f"{path}: powers from {power.min():g} to {power.max():g}, expected none below 0, one above, and none "
                f"of {_MOST_POWER:g} or more"
            )
        return cls(path.name, tuple(nm.tolist()), tuple(power.tolist()))

    @property
    def is_d65(self) -> bool:
        """Whether it is the light of linear sRGB."""
        return self.name == "D65"

    def at(self, wavelengths_nm: Array) -> Array:
        """Power at wavelengths in nm, any shape."""
        return np.interp(wavelengths_nm, self.wavelengths_nm, self.power, left=0.0, right=0.0)


def sensor_responses(illuminant: Illuminant) -> tuple[Array, Array]:
    """What a colorimetric sensor weighs reflectance by: the light times the matching functions.

    Returns:
        wavelengths in nm, shape (K,), every 1 nm, and weights, shape (K, 3), whose sums over wavelengths are the XYZ
        of the perfect diffuser, with Y = 1.
    Raises:
        UsageError: the light has no power where the observer sees.
    """
    nodes, matching = _spectral_distribution(_colour().MSDS_CMFS[OBSERVER])
    stimulus = illuminant.at(nodes)[:, None] * matching
    total = stimulus[:, 1].sum()
    if total <= 0.0:
        raise UsageError(
            f"illuminant {illuminant.name!r} gives no visible light; choose another, such as D65"
        )
    return nodes, stimulus / total


def xyz_to_srgb(xyz: Array, white: Array | None = None) -> Array:
    """Linear sRGB (not clipped) of XYZ (..., 3), seen under a white (3,) that becomes (1, 1, 1); D65 by default."""
    to_rgb = np.linalg.inv(_srgb_to_xyz())
    if white is not None:
        to_rgb = to_rgb @ _adaptation(np.asarray(white, float), _srgb_to_xyz().sum(axis=1))
    return np.asarray(xyz) @ to_rgb.T


def srgb_to_xyz(linear: Array) -> Array:
    """CIE XYZ of linear sRGB (..., 3); white is that of D65 with Y = 1."""
    return np.asarray(linear) @ _srgb_to_xyz().T


def decode_srgb(display: Array) -> Array:
    """Linear sRGB of display values in [0, 1], any shape (IEC 61966-2-1)."""
    return np.asarray(_colour().models.eotf_sRGB(np.asarray(display, dtype=np.float64)))


def _numbers(line: str) -> tuple[float, float] | None:
    """The first two numbers of a line, or None where it does not begin with two, or may hold decimal commas."""
    if re.search(r"\d,\d", line) and re.search(r"[;\s]", line.strip()):
        return None
    cells = line.replace(",", " ").replace(";", " ").split()
    try:
        first, second = float(cells[0]), float(cells[1])
    except (ValueError, IndexError):
        return None
    return (first, second) if np.isfinite(first) and np.isfinite(second) else None


def delta_e_2000(xyz: Array, xyz_star: Array, white: Array) -> Array:
    """CIEDE2000 between colours seen under one white, shape (...).

    Args:
        xyz, xyz_star: CIE XYZ, shape (..., 3), in the units of the white.
        white: XYZ of the perfect diffuser, shape (3,), with Y = 1.
    Source: CIE 142-2001; Sharma, Wu & Dalal 2005.
    """
    xy = np.asarray(white[:2]) / np.sum(white)
    lab, lab_star = (np.asarray(_colour().XYZ_to_Lab(np.asarray(c), xy)) for c in (xyz, xyz_star))
    return np.asarray(_colour().delta_E(lab, lab_star, method="CIE 2000"))


def illuminant_power(bands: Bands, illuminant: str) -> Array:
    """Relative spectral power of an illuminant at the bands, shape (B,); 1 for RGB bands.

    0 where its table does not reach.

    Raises:
        UsageError: there is no such illuminant.
    """
    key = _illuminant_key(illuminant)
    if bands.is_rgb:
        return np.ones(bands.count)
    lamp_nm, lamp = _spectral_distribution(_colour().SDS_ILLUMINANTS[key])
    return np.interp(np.asarray(bands.wavelengths_nm), lamp_nm, lamp, left=0.0, right=0.0)


def luminance(values: Array, bands: Bands, illuminant: str = "D65") -> Array:
    """Y of reflectance-like spectra, shape (...): 1 for a perfect diffuser, by default under D65.

    D65 is the choice that agrees with the Y of linear sRGB, so spectral and RGB materials compare.

    Args, raises: as `to_xyz`.
    """
    return _require_bands(values, bands) @ xyz_weights(bands, illuminant)[:, 1]


def xyz_weights(bands: Bands, illuminant: str = "D65") -> Array:
    """The read-only matrix (B, 3) that takes band values to XYZ; see `to_xyz`.

    Raises:
        UsageError: there is no such illuminant, or it gives no light where the observer sees.
    """
    return _xyz_weights(bands, _illuminant_key(illuminant))


@lru_cache(maxsize=64)
def _xyz_weights(bands: Bands, illuminant: str) -> Array:
    if bands.is_rgb:
        return _frozen(_srgb_to_xyz().T.copy())
    nodes, weights = sensor_responses(Illuminant.named(illuminant))
    return _frozen(interpolation_matrix(np.asarray(bands.wavelengths_nm), nodes).T @ weights)


def interpolation_matrix(nodes: Array, at: Array) -> Array:
    """The matrix (K, n) of linear interpolation from n nodes to K points, constant beyond the ends."""
    return np.stack([np.interp(at, nodes, row) for row in np.eye(len(nodes))], axis=1)


@lru_cache(maxsize=1)
def _srgb_to_xyz() -> Array:
    """The matrix (3, 3) from linear sRGB to XYZ, from the primaries and white: the standard rounds it."""
    colour = _colour()
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    return _frozen(np.asarray(colour.normalised_primary_matrix(srgb.primaries, srgb.whitepoint), float))


def _adaptation(white: Array, target: Array) -> Array:
    """Bradford's matrix (3, 3) that takes XYZ seen under one white to XYZ seen under another."""
    return np.linalg.solve(_BRADFORD, ((_BRADFORD @ target) / (_BRADFORD @ white))[:, None] * _BRADFORD)


def _illuminant_key(name: str) -> str:
    key = _CIE_FLUORESCENT.get(name, name)
    # colour's mappings ignore case in look-ups; membership by list keeps one spelling per illuminant.
    if key not in list(_colour().SDS_ILLUMINANTS):
        raise UsageError(f"no illuminant named {name!r}; {_near(name, illuminant_names())}")
    return key


def _near(name: str, known: Iterable[str]) -> str:
    """`did you mean ...?`, or the known names where none is near."""
    by_lower = {k.lower(): k for k in known}
    near = [by_lower[k] for k in difflib.get_close_matches(name.lower(), by_lower, n=5, cutoff=0.5)]
    if near:
        return f"did you mean {', '.join(near)}?"
    return f"known: {', '.join(sorted(by_lower.values()))}"


def _require_bands(values: Array, bands: Bands) -> Array:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != bands.count:
        raise ShapeError(f"values have shape {values.shape}, expected (..., {bands.count}) for {bands}")
    return values


def _frozen(a: Array) -> Array:
    """The same array, read-only: cached arrays are shared."""
    a.setflags(write=False)
    return a


@lru_cache(maxsize=1)
def _colour() -> ModuleType:
    """The package colour-science, imported without its remarks on optional packages."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
        import colour.quality
    return colour


def _spectral_distribution(table: object) -> tuple[Array, Array]:
    """Wavelengths in nm and values of one of colour-science's distributions, as plain arrays."""
    return np.asarray(table.wavelengths, float), np.asarray(table.values, float)  # type: ignore[attr-defined]


@lru_cache(maxsize=1)
def _reflectances() -> dict[str, tuple[Array, Array]]:
    """All measured reflectances by `set/name`: wavelengths in nm and values."""
    colour = _colour()
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
    return {
        f"{s}/{name}": _spectral_distribution(t) for s, table in sets.items() for name, t in table.items()
    }


@lru_cache(maxsize=1)
def _ior_files() -> dict[str, tuple[Path, Path]]:
    """The files of eta and k by material. Only Mitsuba's folder is looked up; Mitsuba is not imported."""
    # Past sys.modules: an imported mitsuba that has set a variant no longer says where it lies.
    spec = PathFinder.find_spec("mitsuba")
    folders = [Path(p) / "data" / "ior" for p in (spec.submodule_search_locations or [])] if spec else []
    found = {
        path.name.removesuffix(".eta.spd"): (path, path.with_name(path.name.replace(".eta.", ".k.")))
        for folder in folders
        for path in folder.glob("*.eta.spd")
    }
    if not found:
        raise FileFormatError("mitsuba: found no data/ior/*.eta.spd in the package; reinstall mitsuba>=3.6")
    return {name: pair for name, pair in found.items() if pair[1].is_file()}


@lru_cache(maxsize=256)
def _read_spd(path: Path) -> tuple[Array, Array]:
    """Wavelengths in nm, increasing, and values of a file of `wavelength value` lines."""
    try:
        table = np.loadtxt(path, comments="#", ndmin=2)
    except ValueError as error:
        raise FileFormatError(f"{path.name}: {error}; expected lines of `wavelength value`") from error
    if table.shape[1] != 2 or not np.all(np.diff(table[:, 0]) > 0):
        raise FileFormatError(f"{path.name}: expected two columns, wavelengths increasing; reinstall mitsuba")
    return _frozen(table[:, 0].copy()), _frozen(table[:, 1].copy())


def _interpolate(wavelengths_nm: Array, nodes_nm: Array, values: Array) -> Array:
    """Linear between the nodes, constant outside."""
    return np.interp(np.asarray(wavelengths_nm, float), nodes_nm, values)
