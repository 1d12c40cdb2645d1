"""Changes the gloss, lightness, chroma and hue of materials, and finds materials of a library by these attributes.

On a map, the colour of a prediction is changed; the gloss is changed by replacing the coat. Gloss is in gloss units
(ISO 2813). Lightness, chroma and hue are CIELAB values under D65 in the geometry 45/0, lit at 45 degrees and seen
along the normal.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from manifold.brdf.interface import BRDF, EvaluableBRDF
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz, to_xyz, xyz_weights
from manifold.colour.difference import (
    VISIBLE,
    delta_e_2000,
    delta_e_2000_lab,
    is_beyond_reflectances,
    to_lab,
)
from manifold.colour.narrow_bands import with_spectra
from manifold.colour.reflectances import srgb_spectra
from manifold.core import progress
from manifold.core.defaults import DARKEST
from manifold.core.directions import from_spherical, rotate_z
from manifold.core.errors import UsageError
from manifold.core.judged_lights import LIGHTS
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands, plain
from manifold.estimate.gloss import gloss_units
from manifold.formats.readings import DAYLIGHT, GLOSS_ANGLES_DEG, NO_GLOSS, GlossUnits, Readings, gloss_fault
from manifold.library.store import Library
from manifold.model.blend_space import require_blends
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.decoding import decoder_at
from manifold.model.manifold import Manifold
from manifold.model.places import Place, PlaceLike

LEAST_GLOSS = 0.01  # gloss units
_GREY = 0.2
COLOUR_GEOMETRY = from_spherical(np.pi / 4, 0.0), from_spherical(0.0, 0.0)
"""Directions to the light and to the viewer, each (3,), of the geometry 45/0, in which colours are measured."""
# Relative, and CIEDE2000: beyond them something was not reached.
GLOSS_TOLERANCE, COLOUR_TOLERANCE = 0.05, VISIBLE
_JUST_VISIBLE = np.log(1.2)  # difference of log gloss: a fifth more, about as visible as a CIEDE2000 of 1


class NotReachedWarning(UserWarning):
    """Warns that a material does not have all requested attributes; it is issued before the file is written."""


@dataclass(frozen=True)
class Wanted:
    """A requested value of an attribute or, if `is_relative`, a difference from the material's present value."""

    value: float
    is_relative: bool = False

    @classmethod
    def parse(cls, text: str) -> Wanted:
        """Parse `30`, `+10` or `-10`; a sign makes the value relative."""
        if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)", text.strip()):
            raise UsageError(f"found '{text}', expected a number such as 30, or +10 or -10 for a change")
        return cls(float(text), text.strip()[0] in "+-")

    def of(self, present: float) -> float:
        """Return the requested absolute value, given the material's present value."""
        return present + self.value if self.is_relative else self.value


@dataclass(frozen=True, eq=False)
class Attribute:
    """An attribute that users can request of a material.

    Attributes:
        key: name of the attribute in Python; see `Attributes`.
        label: name of the attribute in sentences.
        shown: format string for the value in texts.
        json: keys that lead to the value in JSON.
        measure: function that returns the value for a BRDF.
        fault: function that returns what is wrong with a requested value; None if the value is possible.
        tolerance: relative difference beyond which a value was not reached; the colour attributes share
            `COLOUR_TOLERANCE`.
        angle_deg: angle of a gloss attribute, which is changed by another coat; None for other attributes.
        period: period of the values; values that differ by it are equal.
    """

    key: str
    label: str
    shown: str
    json: tuple[str, ...]
    measure: Callable[[EvaluableBRDF], float]
    fault: Callable[[float], str | None]
    tolerance: float = GLOSS_TOLERANCE
    angle_deg: float | None = None
    period: float | None = None

    def value(self, wanted: Wanted, present: float) -> float:
        """Return the requested value, given the material's present value. Raises UsageError for an impossible value."""
        value = wanted.of(present)
        if (fault := self.fault(value)) is not None:
            raise UsageError(fault)
        return value if self.period is None else value % self.period


def _gloss(angle: float) -> Attribute:
    def fault(units: float) -> str | None:
        if units < LEAST_GLOSS and gloss_fault(angle, units) is None:
            return f"gloss of {units:.4g} units at {angle:g} degrees, expected at least {LEAST_GLOSS}"
        return gloss_fault(angle, units)

    return Attribute(
        f"gloss_{angle:g}", f"gloss at {angle:g} degrees", "gloss {:.3g} at " + f"{angle:g} degrees",
        ("gloss", f"{angle:g}"), lambda brdf: gloss_units(brdf, [angle])[angle], fault,
        angle_deg=angle,
    )  # fmt: skip


def _coordinate(
    key: str, letter: str, least: float, most: float, *, json: str | None = None, period: float | None = None
) -> Attribute:
    """Return the attribute of the next coordinate of the colour."""
    k, digits = "LCh".index(letter), 0 if period else 1

    def fault(value: float) -> str | None:
        if least <= value <= most:
            return None
        expected = f"{least:g} or more" if np.isinf(most) else f"{least:g} to {most:g}"
        return f"{key} {value:.4g}, expected {expected}"

    return Attribute(
        key, key, f"{letter} {{:.{digits}f}}", (json or key,), lambda brdf: float(_to_lch(lab_of(brdf))[k]), fault,
        period=period,
    )  # fmt: skip


COLOUR = (
    _coordinate("lightness", "L", 0.0, 100.0),
    _coordinate("chroma", "C", 0.0, np.inf),
    _coordinate("hue", "h", -np.inf, np.inf, json="hue_deg", period=360.0),
)
"""The attributes of a colour, in the order of its coordinates: CIELAB lightness, chroma, and hue in degrees."""
ATTRIBUTES = {each.key: each for each in (*map(_gloss, GLOSS_ANGLES_DEG), *COLOUR)}
"""All attributes by key; a new attribute needs an entry here and an option in `cli.options.AttributeOptions`."""


@dataclass(frozen=True)
class Attributes:
    """The requested attributes of a material, by key of `ATTRIBUTES`; all others keep their present value."""

    wanted: Mapping[str, Wanted] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in self.wanted:
            if key not in ATTRIBUTES:
                raise UsageError(f"attribute '{key}', expected one of {', '.join(ATTRIBUTES)}")

    def __bool__(self) -> bool:
        """Return whether anything is wanted."""
        return bool(self.wanted)

    @property
    def is_tinted(self) -> bool:
        """Return whether a colour attribute is requested."""
        return any(each.key in self.wanted for each in COLOUR)

    def split(self) -> tuple[Attributes, Attributes]:
        """Return two groups: attributes that another colour reaches, and gloss, which another coat reaches."""
        gloss = {key: wanted for key, wanted in self.wanted.items() if ATTRIBUTES[key].angle_deg is not None}
        return Attributes(
            {key: wanted for key, wanted in self.wanted.items() if key not in gloss}
        ), Attributes(gloss)

    def values(self, present: EvaluableBRDF) -> dict[str, float]:
        """Return the requested absolute values by key, given the present material."""
        return {
            key: ATTRIBUTES[key].value(wanted, ATTRIBUTES[key].measure(present))
            for key, wanted in self.wanted.items()
        }

    @classmethod
    def parse(cls, options: Mapping[str, str | Iterable[str] | None]) -> Attributes | None:
        """Parse texts such as `+10` by key, or lists of texts such as `60=40` for gloss.

        Returns None if no attribute is given.
        """
        wanted: dict[str, Wanted] = {}
        for name, given in options.items():
            if given is None or isinstance(given, str):
                wanted |= {} if given is None else {name: Wanted.parse(given)}
                continue
            for text in given:
                angle, _, value = text.rpartition("=")
                if f"{name}_{angle}" not in ATTRIBUTES:
                    raise UsageError(
                        f"{name} '{text}', expected ANGLE=UNITS at 20, 60 or 85 degrees, such as 60=40"
                    )
                wanted[f"{name}_{angle}"] = Wanted.parse(value)
        return cls(wanted) if wanted else None


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A material that was adjusted to requested attributes.

    Attributes:
        place: its point on the map, with the rotation of the given material; None if a material's own values were
            edited.
        colours: its colours, as `Manifold.predict` takes them.
        asked, reached: requested and reached values by key of `ATTRIBUTES`; they include the colour.
    """

    place: Place | None
    colours: Array | None
    asked: Mapping[str, float]
    reached: Mapping[str, float]

    @property
    def difference(self) -> float:
        """CIEDE2000 between the requested and the reached colour."""
        asked, reached = (
            from_lch(np.array([values[each.key] for each in COLOUR])) for values in (self.asked, self.reached)
        )
        return float(delta_e_2000_lab(asked, reached))

    @property
    def meters(self) -> list[Attribute]:
        """The requested attributes, except those of the colour."""
        return [ATTRIBUTES[key] for key in self.asked if ATTRIBUTES[key] not in COLOUR]

    def __str__(self) -> str:
        return ", ".join(each.shown.format(self.reached[each.key]) for each in (*COLOUR, *self.meters))

    def reached_by(self, brdf: EvaluableBRDF, asked: Mapping[str, float]) -> Adjusted:
        """Return a copy with further requested values; the reached values are the attributes of `brdf`."""
        asked = {**self.asked, **asked}
        return replace(self, asked=asked, reached=measured(brdf, asked))

    @property
    def shortfalls(self) -> tuple[str, ...]:
        """Return sentences on the attributes that could not be reached."""
        shortfalls = [
            f"{each.label}: {self.reached[each.key]:.3g} reached, {self.asked[each.key]:.3g} requested; no material "
            f"near it in this colour has that {each.key.partition('_')[0]}"
            for each in self.meters
            if abs(self.reached[each.key] - self.asked[each.key]) > each.tolerance * self.asked[each.key]
        ]
        if self.difference > COLOUR_TOLERANCE:
            asked, reached = (
                ", ".join(each.shown.format(values[each.key]) for each in COLOUR)
                for values in (self.asked, self.reached)
            )
            difference = f"CIEDE2000 {self.difference:.1f} ({DAYLIGHT}, 45/0)"
            wanted = from_lch(np.array([self.asked[each.key] for each in COLOUR]))
            if is_beyond_reflectances(wanted, 0.0):
                difference += "; no reflectance has the requested colour, this is the nearest in CIELAB"
            shortfalls.append(f"colour: {reached} reached, {asked} requested, {difference}")
        return tuple(shortfalls)

    def warn(self) -> None:
        """Issue a warning for values that could not be reached; call it before anything is written."""
        for shortfall in self.shortfalls:
            warnings.warn(shortfall, NotReachedWarning, stacklevel=3)

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain values for JSON."""
        known = {
            "latent": None if self.place is None or self.place.is_step(self.colours) else self.place.latent,
            "asked": self._nested(self.asked),
            "reached": self._nested(self.reached),
            "ciede2000": self.difference,
            "shortfalls": self.shortfalls,
        }
        return plain(known)

    def _nested(self, values: Mapping[str, float]) -> dict[str, Any]:
        nested: dict[str, Any] = {"gloss": {}}
        for each in (*COLOUR, *self.meters):
            *outer, last = each.json
            inner = nested
            for key in outer:
                inner = inner.setdefault(key, {})
            inner[last] = values[each.key]
        return nested


def by_angle(values: Mapping[str, float]) -> dict[float, float]:
    """Return the gloss units among attribute values, by angle in degrees."""
    return {angle: value for key, value in values.items() if (angle := ATTRIBUTES[key].angle_deg) is not None}


def measured(brdf: EvaluableBRDF, keys: Iterable[str]) -> dict[str, float]:
    """Return the requested attributes of a BRDF by key, and always its colour."""
    values = {key: ATTRIBUTES[key].measure(brdf) for key in keys if ATTRIBUTES[key] not in COLOUR}
    return values | {
        each.key: value for each, value in zip(COLOUR, _to_lch(lab_of(brdf)).tolist(), strict=True)
    }


def adjust(model: Manifold, x: PlaceLike, attributes: Attributes, colour: ColourChoice = NEAREST) -> Adjusted:
    """Find the colours that have the requested attributes and are nearest to the colours of a material at x.

    Only a map of blends can change colours. To change the gloss, use `coat.with_gloss`.

    >>> adjust(model, "syn_card_brown", Attributes({"hue": Wanted(30.0)}))  # doctest: +SKIP
    """
    place = model.place(x)
    colours = model.choose_colour(place, colour).colours
    present = model.predict(place, colours).turned(place.rotation_rad)
    asked = measured(present, ()) | attributes.values(present)
    if attributes.is_tinted:
        lab = from_lch(np.array([asked[each.key] for each in COLOUR]))
        colours = _colours_at(model, place, tinted(factor_of(present), lab, model.bands))
    reached = model.predict(place, colours).turned(place.rotation_rad)
    return Adjusted(place, colours, asked, measured(reached, asked))


def _colours_at(model: Manifold, place: Place, factor: Array) -> Array:
    """Return colours (B,) at which a point has a reflectance factor (B,) in the geometry 45/0, as the sample lies."""
    pairs = Pairs(*(rotate_z(w[None], -place.rotation_rad) for w in COLOUR_GEOMETRY))
    decoder = decoder_at(pairs, model.space, model.materials, model.settings)
    return require_blends(model.space).colours_of(place.latent, factor, decoder, np.array([np.pi]))[0]


def readings_of_colour(lab: Array, gloss: GlossUnits, bands: Bands) -> Readings:
    """Return a colour, CIELAB (3,) under D65 at 45/0, and gloss units by angle, as readings of a material.

    The spectrum is the smoothest spectrum of that colour.
    """
    values = factor_of_colour(lab, bands)[None] / np.pi
    name = "L {:.4g}, a {:.4g}, b {:.4g}".format(*lab)
    wavelengths = None if bands.is_rgb else np.asarray(bands.wavelengths_nm)
    wi, wo = COLOUR_GEOMETRY
    return Readings(name, "45/0", wi[None], wo[None], wavelengths, values, gloss=gloss)


def lab_of(brdf: EvaluableBRDF) -> Array:
    """Return the CIELAB colour (3,) of a BRDF under D65, lit at 45 degrees and seen along the normal."""
    return lab_of_factor(factor_of(brdf), brdf.bands)


def factor_of_colour(lab: Array, bands: Bands) -> Array:
    """Return the smoothest reflectance factor (B,) of a colour (3,), close to the factor of a grey."""
    return tinted(np.full(bands.count, _GREY), np.asarray(lab, float), bands)


def tinted(factor: Array, lab: Array, bands: Bands) -> Array:
    """Return a reflectance factor (B,) changed to a CIELAB colour (3,), by smooth factors as near to 1 as possible."""
    primaries = np.eye(3) if bands.is_rgb else srgb_spectra(bands)
    base = np.maximum(factor, DARKEST)

    def gained(a: Array) -> Array:
        return base * np.exp(a @ primaries)

    def off(a: Array) -> Array:
        return lab_of_factor(gained(a), bands) - lab

    return gained(scipy.optimize.least_squares(off, np.zeros(3), bounds=(-7.0, 7.0)).x)


def factor_of(brdf: EvaluableBRDF) -> Array:
    """Return the reflectance factor (B,) of a BRDF in the geometry 45/0."""
    return np.pi * brdf.eval(*COLOUR_GEOMETRY)


def lab_of_factor(factor: Array, bands: Bands) -> Array:
    """Return the CIELAB colour (3,) of a reflectance factor (B,) under D65."""
    return to_lab(to_xyz(factor, bands), xyz_weights(bands).sum(axis=0))


def _to_lch(lab: Array) -> Array:
    """Return lightness, chroma, hue in degrees."""
    return np.array([lab[0], np.hypot(lab[1], lab[2]), np.rad2deg(np.arctan2(lab[2], lab[1])) % 360.0])


def from_lch(lch: Array) -> Array:
    """Convert lightness, chroma, and hue in degrees (3,) to CIELAB (3,)."""
    hue = np.deg2rad(lch[2])
    return np.array([lch[0], lch[1] * np.cos(hue), lch[1] * np.sin(hue)])


@dataclass(frozen=True, eq=False)
class Found:
    """A material of a library, and how it differs from the requested colour, gloss or material.

    Attributes:
        lab: its CIELAB colour in the geometry 45/0, shape (3,).
        gloss: its gloss units by angle in degrees.
        ciede2000: CIEDE2000 from the requested colour or material; None if neither was given.
        light: name of the light in which `ciede2000` is computed; None if `ciede2000` is None.
        distance: root of the summed squares of CIEDE2000 and of the gloss differences in just visible steps; if a
            material was given, `ciede2000`.
    """

    name: str
    lab: Array
    gloss: GlossUnits
    ciede2000: float | None
    light: str | None
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain values for JSON."""
        return plain(vars(self) | {"gloss": {f"{a:g}": units for a, units in self.gloss.items()}})


def find(
    library: Library,
    material: BRDF | Readings | None = None,
    *,
    lab: ArrayLike | None = None,
    gloss: GlossUnits = NO_GLOSS,
) -> list[Found]:
    """Return a library's materials, ordered by their similarity to a material, or to a colour and gloss.

    Args:
        library: the library to search.
        material: a BRDF, which is compared as a ball in the five test lights; or readings, which are compared at
            their geometries.
        lab: CIELAB colour in the geometry 45/0 under D65, shape (3,); None for any colour.
        gloss: gloss units by angle: 20, 60 or 85 degrees.
    """
    differs = None if material is None else _difference_from(material)
    light = None if lab is None else f"{DAYLIGHT}, 45/0"
    if material is not None:
        light = str(DAYLIGHT) if isinstance(material, Readings) else LIGHTS
    materials = []
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
        materials.append(Found(name, own, units, difference, light, distance))
        progress.report(k + 1, len(library.names), "materials")
    return sorted(materials, key=lambda one: one.distance)


def _difference_from(sought: BRDF | Readings) -> Callable[[BRDF], float]:
    """Return a function for the CIEDE2000 of BRDFs from another, as balls, or from readings at their geometries."""
    if not isinstance(sought, Readings):
        lights = panel.judged()

        def xyz(brdf: BRDF) -> Array:
            return lights.xyz(np.maximum(values_at(brdf, lights), 0.0), brdf.bands)

        of_sought = xyz(sought)
        return lambda brdf: lights.compare(of_sought, xyz(brdf)).ball

    sought = with_spectra(sought)
    whole = sought.measured.all(axis=1)
    if sought.bands.count < 3 or not whole.any():
        raise UsageError(
            f"{sought.name}: {sought.bands}, expected readings with colours to compare materials by"
        )
    wi, wo = sought.wi[whole], sought.wo[whole]
    white, own = srgb_to_xyz(np.ones(3)), to_xyz(np.pi * np.maximum(sought.values[whole], 0.0), sought.bands)
    return lambda brdf: float(
        delta_e_2000(own, to_xyz(np.pi * np.maximum(brdf.eval(wi, wo), 0.0), brdf.bands), white).mean()
    )
