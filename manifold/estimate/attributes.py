"""Materials by attributes: gloss, lightness, chroma and hue.

A material is found on a map: the place nearest to a given one whose material has the gloss, in the colour that is asked
for or, without one, in the colour of the given material. Gloss is in gloss units (ISO 2813); lightness, chroma
and hue are CIELAB's under D65 for the geometry 45/0, light at 45 degrees seen along the normal. Materials of a library
are found by the same, or by their likeness to another material.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from manifold import progress
from manifold.brdf.interface import BRDF, EvaluableBRDF
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import panel
from manifold.colour.ball_colours import Picture
from manifold.colour.conversion import luminance, srgb_to_xyz, to_xyz, xyz_weights
from manifold.colour.difference import delta_e_2000, delta_e_2000_lab, to_lab
from manifold.colour.narrow_bands import with_spectra
from manifold.colour.reflectances import srgb_spectra
from manifold.directions import from_spherical, rotate_z
from manifold.encoding import Decoder
from manifold.errors import UsageError
from manifold.estimate.gloss import gloss_meter, gloss_units
from manifold.formats.readings import DAYLIGHT, Readings, gloss_fault
from manifold.judged_lights import LIGHTS
from manifold.library.store import Library
from manifold.model.blend_space import require_blends
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.decoding import decoder_at
from manifold.model.manifold import Manifold
from manifold.model.places import Place, PlaceLike
from manifold.pairs import Pairs
from manifold.records import Array, Bands, plain

_GLOSS_WEIGHT = 1e3  # weight of squared errors of log gloss, against squared distance in length scales
_COLOUR_WEIGHT = 1.0  # weight of squared differences in CIELAB, likewise
_ALONG = np.linspace(0.0, 1.0, 11)[:, None]  # places tried, on the way from the given one to every material
_REFINED, _EVALUATIONS = 6, 100
LEAST_GLOSS = 0.01  # gloss units
_GREY = 0.2
_LEAST_REFLECTANCE = 1e-3  # so that black can be tinted
_LIGHT, _NORMAL = from_spherical(np.pi / 4, 0.0), from_spherical(0.0, 0.0)
GLOSS_TOLERANCE, COLOUR_TOLERANCE = 0.05, 1.0  # relative; CIEDE2000: beyond them something was not reached
_JUST_VISIBLE = np.log(1.2)  # difference of log gloss: a fifth more, about as visible as a CIEDE2000 of 1


class NotReachedWarning(UserWarning):
    """A material that is about to be written does not have all attributes that were asked for."""


@dataclass(frozen=True)
class Wanted:
    """A requested value, or, if `is_relative`, a value added to that of the given material."""

    value: float
    is_relative: bool = False

    @classmethod
    def parse(cls, text: str) -> Wanted:
        """Parse `30`, `+10` or `-10`; a sign makes it relative."""
        if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)", text.strip()):
            raise UsageError(f"found '{text}', expected a number such as 30, or +10 or -10 for a change")
        return cls(float(text), text.strip()[0] in "+-")

    def of(self, present: float) -> float:
        """Return the absolute value for a material's present one."""
        return present + self.value if self.is_relative else self.value


@dataclass(frozen=True)
class Attributes:
    """The attributes that a material should have; None or no entry keeps the present one.

    Attributes:
        gloss: gloss units at 20, 60 or 85 degrees.
        lightness, chroma: of CIELAB.
        hue: in degrees.
    """

    gloss: Mapping[float, Wanted] = field(default_factory=dict)
    lightness: Wanted | None = None
    chroma: Wanted | None = None
    hue: Wanted | None = None

    def lch(self, present: Array) -> Array:
        """Return the requested lightness, chroma and hue in degrees for a material's present ones (3,)."""
        wanted = (self.lightness, self.chroma, self.hue)
        lightness, chroma, hue = (
            now if w is None else w.of(now) for w, now in zip(wanted, present, strict=True)
        )
        if not 0.0 <= lightness <= 100.0 or chroma < 0.0:
            raise UsageError(
                f"lightness {lightness:.4g} and chroma {chroma:.4g}, expected 0 to 100, and 0 or more"
            )
        return np.array([lightness, chroma, hue % 360.0])

    def units(self, present: Mapping[float, float]) -> dict[float, float]:
        """Return the requested gloss units by angle in degrees for a material's present ones."""
        units = {angle: self.gloss[angle].of(now) for angle, now in present.items()}
        for angle, asked in units.items():
            if (fault := gloss_fault(angle, asked)) is not None:
                raise UsageError(fault)
            if asked < LEAST_GLOSS:
                raise UsageError(
                    f"gloss of {asked:.4g} units at {angle:g} degrees, expected at least {LEAST_GLOSS}"
                )
        return units

    @classmethod
    def parse(
        cls,
        gloss: Iterable[str] = (),
        lightness: str | None = None,
        chroma: str | None = None,
        hue: str | None = None,
    ) -> Attributes | None:
        """Parse texts such as `60=40` for gloss and `+10` for the others; return None if all are missing."""
        given = {}
        for text in gloss:
            angle, _, units = text.rpartition("=")
            if angle not in ("20", "60", "85"):
                raise UsageError(
                    f"gloss '{text}', expected ANGLE=UNITS at 20, 60 or 85 degrees, such as 60=40"
                )
            given[float(angle)] = Wanted.parse(units)
        colour = [None if text is None else Wanted.parse(text) for text in (lightness, chroma, hue)]
        return cls(given, *colour) if given or any(colour) else None


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A material with attributes.

    Attributes:
        place: where it is on the map, turned as the given one.
        colours: its colours there, as `Manifold.predict` takes them.
        gloss: gloss units by angle in degrees, as asked and as reached.
        lch: lightness, chroma and hue in degrees, as asked and as reached, each (3,).
        difference: CIEDE2000 between these colours.
    """

    place: Place
    colours: Array | None
    gloss: Mapping[float, tuple[float, float]]
    lch: tuple[Array, Array]
    difference: float

    def __str__(self) -> str:
        lightness, chroma, hue = self.lch[1]
        words = [f"L {lightness:.1f}, C {chroma:.1f}, h {hue:.0f}"]
        return ", ".join(
            words + [f"gloss {found:.3g} at {angle:g} degrees" for angle, (_, found) in self.gloss.items()]
        )

    def reached_by(self, brdf: EvaluableBRDF, units: Mapping[float, float]) -> Adjusted:
        """Return the result with a BRDF's attributes, for which gloss units by angle in degrees were requested."""
        wanted, found = self.lch[0], lab_of(brdf)
        gloss = {angle: (units[angle], reached) for angle, reached in gloss_units(brdf, units).items()}
        difference = float(delta_e_2000_lab(_from_lch(wanted), found))
        return replace(self, gloss=gloss, lch=(wanted, _to_lch(found)), difference=difference)

    @property
    def shortfalls(self) -> tuple[str, ...]:
        """Return sentences on the attributes that could not be reached."""
        shortfalls = [
            f"gloss at {angle:g} degrees: {reached:.3g} reached, {asked:.3g} requested; no material near it "
            "in this colour has that gloss"
            for angle, (asked, reached) in self.gloss.items()
            if abs(reached - asked) > GLOSS_TOLERANCE * asked
        ]
        if self.difference > COLOUR_TOLERANCE:
            asked, reached = ("L {:.1f}, C {:.1f}, h {:.0f}".format(*lch) for lch in self.lch)
            difference = f"CIEDE2000 {self.difference:.1f} ({DAYLIGHT}, 45/0)"
            shortfalls.append(f"colour: {reached} reached, {asked} requested, {difference}")
        return tuple(shortfalls)

    def warn(self) -> None:
        """Warn of values that could not be reached, before anything is written."""
        for shortfall in self.shortfalls:
            warnings.warn(shortfall, NotReachedWarning, stacklevel=3)

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        lch = [dict(zip(("lightness", "chroma", "hue_deg"), one, strict=True)) for one in self.lch]
        known = {
            "latent": None if self.place.is_step(self.colours) else self.place.latent,
            "asked": lch[0] | {"gloss": {f"{angle:g}": asked for angle, (asked, _) in self.gloss.items()}},
            "reached": lch[1] | {"gloss": {f"{angle:g}": found for angle, (_, found) in self.gloss.items()}},
            "ciede2000": self.difference,
            "shortfalls": self.shortfalls,
        }
        return plain(known)


def adjust(model: Manifold, x: PlaceLike, attributes: Attributes, colour: ColourChoice = NEAREST) -> Adjusted:
    """Find the place on a map of blends and the colours nearest to a material at x that have some attributes.

    >>> adjust(model, "syn_card_brown", Attributes({60.0: Wanted(40.0)}, hue=Wanted(30.0)))  # doctest: +SKIP
    """
    place = model.place(x)
    chosen = model.choose_colour(place, colour)
    present = model.predict(place, chosen.colours).turned(place.rotation_rad)
    search = _Search(model, tuple(attributes.gloss), place.rotation_rad)
    wanted = attributes.lch(_to_lch(lab_of(present)))
    factor, is_tinted = factor_of(present), bool(attributes.lightness or attributes.chroma or attributes.hue)
    if is_tinted:
        factor = tinted(factor, _from_lch(wanted), model.bands)
    units = attributes.units(gloss_units(present, attributes.gloss))
    latent = search.nearest(place.latent, factor, units)
    colours = search.colours(latent, factor) if units or is_tinted else chosen.colours
    moved = replace(place, latent=latent, walk=None) if units else place
    reached = model.predict(moved, colours).turned(place.rotation_rad)
    return Adjusted(moved, colours, {}, (wanted, wanted), 0.0).reached_by(reached, units)


def readings_of_colour(lab: Array, gloss: Mapping[float, float], bands: Bands) -> Readings:
    """Return a colour (3,), CIELAB under D65 at 45/0, and gloss units by angle, as readings of a material.

    The spectrum is the smoothest of that colour, as colours have no other.
    """
    values = tinted(np.full(bands.count, _GREY), lab, bands)[None] / np.pi
    name = "L {:.4g}, a {:.4g}, b {:.4g}".format(*lab)
    wavelengths = None if bands.is_rgb else np.asarray(bands.wavelengths_nm)
    return Readings(name, "45/0", _LIGHT[None], _NORMAL[None], wavelengths, values, gloss=gloss)


def lab_of(brdf: EvaluableBRDF) -> Array:
    """Return the CIELAB (3,) of a BRDF under D65, lit at 45 degrees and seen along the normal."""
    return lab_of_factor(factor_of(brdf), brdf.bands)


class _Search:
    """Looks for places of a map by gloss, in a given colour, of a sample that lies turned."""

    def __init__(self, model: Manifold, angles: tuple[float, ...], rotation_rad: float) -> None:
        self._model, self._space = model, require_blends(model.space)
        self._angles = angles
        self._rotation_rad = rotation_rad

    @cached_property
    def _reflectometer(self) -> Decoder:
        return self._decoder(_LIGHT[None], _NORMAL[None])

    @cached_property
    def _meters(self) -> dict[float, tuple[Picture, Decoder]]:
        meters = {angle: gloss_meter(angle) for angle in self._angles}
        return {a: (m, self._decoder(m.wi, m.wo)) for a, m in meters.items()}

    def _decoder(self, wi: Array, wo: Array) -> Decoder:
        model, back = self._model, -self._rotation_rad
        pairs = Pairs(rotate_z(wi, back), rotate_z(wo, back))
        return decoder_at(pairs, model.space, model.materials, model.settings)

    def colours(self, x: Array, factor: Array) -> Array:
        """Return colours (B,) at which a place x (Q,) has a reflectance factor (B,) in the geometry 45/0."""
        return self._space.colours_of(x, factor, self._reflectometer, np.array([np.pi]))[0]

    def nearest(self, start: Array, factor: Array, units: Mapping[float, float]) -> Array:
        """Return the place nearest to a start (Q,) with gloss units by angle in degrees.

        Its colour is that of a reflectance factor (B,).
        """
        if not units:
            return start

        bands, spot = self._model.bands, np.array([np.pi])
        lab = lab_of_factor(factor, bands)

        def cost(x: Array) -> float:
            colours, reached = self._space.colours_of(x, factor, self._reflectometer, spot)
            off = lab_of_factor(reached, bands) - lab
            penalty = _COLOUR_WEIGHT * float(off @ off)
            for angle, asked in units.items():
                meter, decoder = self._meters[angle]
                in_bands = self._space.reflectance_of(x, colours, decoder, meter.light)
                gloss = float(luminance(in_bands, self._model.bands))
                penalty += _GLOSS_WEIGHT * np.log(max(gloss, LEAST_GLOSS) / asked) ** 2
            return float(np.sum((x - start) ** 2)) + penalty

        ways = [min(start + _ALONG * (end - start), key=cost) for end in self._model.X]
        tried = sorted(ways, key=cost)[:_REFINED]
        found = [
            scipy.optimize.minimize(
                cost, x, method="Nelder-Mead", options={"maxfev": _EVALUATIONS, "xatol": 1e-4, "fatol": 1e-4}
            )
            for x in tried
        ]
        return min(found, key=lambda one: one.fun).x


def tinted(factor: Array, lab: Array, bands: Bands) -> Array:
    """Bring a reflectance factor (B,) to a colour (3,) by smooth gains that are as near to 1 as possible."""
    primaries = np.eye(3) if bands.is_rgb else srgb_spectra(bands)
    base = np.maximum(factor, _LEAST_REFLECTANCE)

    def gained(a: Array) -> Array:
        return base * np.exp(a @ primaries)

    def off(a: Array) -> Array:
        return lab_of_factor(gained(a), bands) - lab

    return gained(scipy.optimize.least_squares(off, np.zeros(3), bounds=(-7.0, 7.0)).x)


def factor_of(brdf: EvaluableBRDF) -> Array:
    """Return the reflectance factor (B,) of the geometry 45/0."""
    return np.pi * brdf.eval(_LIGHT, _NORMAL)


def lab_of_factor(factor: Array, bands: Bands) -> Array:
    """Return the CIELAB (3,) under D65 of a reflectance factor (B,)."""
    return to_lab(to_xyz(factor, bands), xyz_weights(bands).sum(axis=0))


def _to_lch(lab: Array) -> Array:
    """Return lightness, chroma, hue in degrees."""
    return np.array([lab[0], np.hypot(lab[1], lab[2]), np.rad2deg(np.arctan2(lab[2], lab[1])) % 360.0])


def _from_lch(lch: Array) -> Array:
    hue = np.deg2rad(lch[2])
    return np.array([lch[0], lch[1] * np.cos(hue), lch[1] * np.sin(hue)])


@dataclass(frozen=True, eq=False)
class Found:
    """A measured material beside the one that was searched for.

    Attributes:
        lab: its CIELAB colour in the geometry 45/0, shape (3,).
        gloss: its gloss units by angle in degrees.
        ciede2000: to the colour or the material looked for; None where none was given.
        light: in which that is; None likewise.
        distance: root of the summed squares of CIEDE2000 and of gloss in just visible steps; from a material, the
            CIEDE2000 between both.
    """

    name: str
    lab: Array
    gloss: Mapping[float, float]
    ciede2000: float | None
    light: str | None
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return plain(vars(self) | {"gloss": {f"{a:g}": units for a, units in self.gloss.items()}})


def find(
    library: Library,
    material: BRDF | Readings | None = None,
    *,
    lab: ArrayLike | None = None,
    gloss: Mapping[float, float] = MappingProxyType({}),
) -> list[Found]:
    """Return a library's materials, ordered by their resemblance to another, or to a colour and gloss.

    BRDFs are compared as balls in the judged lights of `colour.panel`; readings at their geometries, in which case
    materials without gloss near it may be listed. `lab` is in the geometry 45/0 under D65, shape (3,), None for any;
    gloss is in units by angle, 20, 60 or 85 degrees.
    """
    differs = None if material is None else _difference_from(material)
    light = None if lab is None else f"{DAYLIGHT}, 45/0"
    if material is not None:
        light = str(DAYLIGHT) if isinstance(material, Readings) else LIGHTS
    found = []
    for k, name in enumerate(library.names):
        brdf = MeasuredBRDF(fill_unmeasured(library.read(name)))
        own, units = lab_of(brdf), gloss_units(brdf, gloss or (60.0,))
        difference = None if lab is None else float(delta_e_2000_lab(np.asarray(lab), own))
        if differs is not None:
            difference = differs(brdf)
        steps = [
            np.log(max(units[a], LEAST_GLOSS) / max(asked, LEAST_GLOSS)) / _JUST_VISIBLE
            for a, asked in gloss.items()
        ]
        distance = float(np.hypot(difference or 0.0, np.linalg.norm(steps)))
        found.append(Found(name, own, units, difference, light, distance))
        progress.report(k + 1, len(library.names), "materials")
    return sorted(found, key=lambda one: one.distance)


def _difference_from(sought: BRDF | Readings) -> Callable[[BRDF], float]:
    """Return a function for the CIEDE2000 of BRDFs from another, as balls, or from readings at their geometries."""
    if isinstance(sought, Readings):
        return _from_readings(sought)
    lights = panel.judged()

    def xyz(brdf: BRDF) -> Array:
        return lights.xyz(np.maximum(values_at(brdf, lights), 0.0), brdf.bands)

    own = xyz(sought)
    return lambda brdf: lights.compare(own, xyz(brdf)).ball


def _from_readings(sought: Readings) -> Callable[[BRDF], float]:
    white, sought = srgb_to_xyz(np.ones(3)), with_spectra(sought)
    whole = sought.measured.all(axis=1)
    if sought.bands.count < 3 or not whole.any():
        raise UsageError(
            f"{sought.name}: {sought.bands}, expected readings with colours to compare materials by"
        )
    wi, wo = sought.wi[whole], sought.wo[whole]
    own = to_xyz(np.pi * np.maximum(sought.values[whole], 0.0), sought.bands)
    return lambda brdf: float(
        delta_e_2000(own, to_xyz(np.pi * np.maximum(brdf.eval(wi, wo), 0.0), brdf.bands), white).mean()
    )
