"""Readings of one specimen: values of its BRDF at given directions, from one instrument.

Multi-angle spectrophotometers give a dozen pairs of directions, goniometers thousands. Dense tables, whose nodes are
a product of angles, are `manifold.formats.dense.DenseTable`; `DenseTable.readings` lists them as readings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from manifold.core.defaults import ILLUMINANT, OBSERVER_DEG, REPEATABILITY
from manifold.core.directions import from_spherical, require_directions, require_real
from manifold.core.errors import ShapeError, UsageError
from manifold.core.names import counted
from manifold.core.records import Array, Bands, Indices, Mask

# Anchor leg and aspecular angle in degrees, in the instrument's order.
_MA_T12 = (
    *((45, aspecular) for aspecular in (-15, 15, 25, 45, 75, 110)),
    *((15, aspecular) for aspecular in (-45, -30, -15, 15, 45, 80)),
)
MA_T12_NAMES = tuple(f"{anchor}as{aspecular}" for anchor, aspecular in _MA_T12)
"""The 12 geometries of an MA-T12, in the order of `geometry_ma_t12`."""

UNITS = {"brdf": 1.0, "factor": 1.0 / np.pi, "percent": 0.01 / np.pi}
"""Factors, in 1/sr, that convert values in tables to the BRDF: from the BRDF, reflectance factors, or percent."""

NO_UNIT = "no unit given"
"""Beginning of a note on an assumed unit."""

_CONTRADICTION = 0.1  # scatter of repeated readings that is noted

GlossUnits: TypeAlias = Mapping[float, float]
"""Gloss units by the angle of the gloss meter in degrees, one or more of `GLOSS_ANGLES_DEG`."""

NO_GLOSS: GlossUnits = MappingProxyType({})
"""No reading of gloss."""

MOST_GLOSS: GlossUnits = {20.0: 2040.0, 60.0: 1000.0, 85.0: 162.0}
"""Gloss units of a mirror that reflects all light: 100 over the reflectance of glass of index 1.567."""

GLOSS_ANGLES_DEG = tuple(MOST_GLOSS)
"""Incidences of gloss meters in degrees (ISO 2813)."""


class Viewing(NamedTuple):
    """The illuminant and the observer under which a colour was computed.

    Attributes:
        illuminant: CIE's name of the light.
        observer_deg: field of view of CIE's standard observer, 2 (1931) or 10 (1964).
    """

    illuminant: str = ILLUMINANT
    observer_deg: int = OBSERVER_DEG

    def __str__(self) -> str:
        return f"{self.illuminant}/{self.observer_deg}"


DAYLIGHT = Viewing()
"""Light and observer of linear sRGB."""


class Assumption(str):
    """A note on an assumed unit or geometry, or on doubtful values, which changes the result if it is wrong."""

    __slots__ = ()


def assumptions_first(notes: Iterable[str]) -> tuple[str, ...]:
    """Return every note once, notes of the class `Assumption` first."""
    return tuple(sorted(dict.fromkeys(notes), key=lambda note: not isinstance(note, Assumption)))


class Between(NamedTuple):
    """How much repeated measurements of one specimen differ.

    Attributes:
        deviation: relative standard deviation between measurements, beyond the repeatability of each.
        ciede2000: CIEDE2000 between two measurements, mean over shared pairs of directions.
        pairs: number of shared pairs of directions.
    """

    deviation: float
    ciede2000: float
    pairs: int


@dataclass(frozen=True, eq=False)
class Readings:
    """The readings of one specimen by an instrument, at P direction pairs in B bands.

    Attributes:
        name: name of the specimen.
        instrument: name of the instrument that the file states, or the format if it states none.
        wi: unit vectors in the local frame (z is the normal), shape (P, 3).
        wo: unit vectors, shape (P, 3).
        wavelengths_nm: band centres in nm, increasing, shape (B,); None for linear sRGB, B = 3.
        values: f in 1/sr, shape (P, B); NaN for unmeasured values; noise may make values slightly negative.
        weights: relative reliability of each pair, at least 0, shape (P,); all 1 by default.
        scatter: relative standard deviation of the cube roots of repeated readings, shape (P,); 0 for pairs without
            repetition.
        colour_error: expected CIEDE2000 of spectra that were estimated from fewer bands; 0 for measured spectra.
        estimated_from: number of bands from which spectra were estimated; None for measured spectra.
        notes: ambiguities of the file and how they were read, one sentence each.
        texture: texture data of the instrument (graininess, sparkle, flake images) by name, as plain values.
        gloss: gloss units of a gloss meter (ISO 2813) by its angle in degrees: 20, 60 or 85.
        repeatability: relative standard deviation of repeated readings or, for the mean of several measurements, of
            repeated measurements.
        assumed_unit: one of `UNITS` if the file states no unit and this one was assumed; otherwise None.
        between: how much several measurements of the specimen differ; None for a single one.
        viewing: light and observer of printed CIELAB values, or, for linear sRGB, to which the colours are
            relative.
        is_viewing_assumed: whether a file of CIELAB values states no illuminant, so that one was assumed.
    """

    name: str
    instrument: str
    wi: Array
    wo: Array
    wavelengths_nm: Array | None
    values: Array
    weights: Array = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()
    texture: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    gloss: GlossUnits = field(default_factory=lambda: NO_GLOSS)
    scatter: Array = field(default_factory=lambda: np.zeros(0))
    colour_error: float = 0.0
    estimated_from: int | None = None
    repeatability: float = REPEATABILITY
    assumed_unit: str | None = None
    viewing: Viewing = DAYLIGHT
    is_viewing_assumed: bool = False
    between: Between | None = None

    @property
    def bands_in_words(self) -> str:
        """Return a text that names the bands, and from how many bands the spectra were estimated."""
        if self.estimated_from is None:
            return str(self.bands)
        return f"{self.estimated_from} bands, estimated at {str(self.bands).replace(' bands', '')}"

    def __post_init__(self) -> None:
        """Check shapes and values, and make arrays read-only."""
        wi, wo = (require_directions(w, f"{self.name}: {n}") for n, w in (("wi", self.wi), ("wo", self.wo)))
        if wi.ndim != 2 or wi.shape != wo.shape or wi.shape[0] == 0:
            raise ShapeError(f"{self.name}: wi has shape {wi.shape}, wo {wo.shape}, expected (P, 3), P > 0")
        if np.any(wi[:, 2] < 0.0) or np.any(wo[:, 2] < 0.0):
            raise ShapeError(f"{self.name}: a direction lies below the horizon, expected z >= 0; drop it")
        nm = None if self.wavelengths_nm is None else np.asarray(self.wavelengths_nm, dtype=np.float64)
        expected = (wi.shape[0], Bands.from_array(nm).count)
        values = np.asarray(require_real(self.values, f"{self.name}: values"), dtype=np.float64)
        if values.shape != expected:
            raise ShapeError(f"{self.name}: values have shape {values.shape}, expected {expected}")
        if np.any(np.isinf(values)):
            raise ShapeError(f"{self.name}: an infinite value, expected f in 1/sr, or NaN where not measured")
        weights = np.asarray(self.weights, dtype=np.float64)
        if weights.size == 0:
            weights = np.ones(expected[0])
        if weights.shape != expected[:1] or not np.all(np.isfinite(weights)) or np.any(weights < 0.0):
            raise ShapeError(
                f"{self.name}: weights have shape {weights.shape}, expected {expected[:1]}, at least 0"
            )
        scatter = (
            np.asarray(self.scatter, dtype=np.float64) if np.size(self.scatter) else np.zeros(expected[0])
        )
        for name, array in (
            ("wi", wi), ("wo", wo), ("values", values), ("weights", weights), ("scatter", scatter),
        ):  # fmt: skip
            object.__setattr__(self, name, _frozen(array))
        object.__setattr__(self, "wavelengths_nm", None if nm is None else _frozen(nm))
        for angle, units in self.gloss.items():
            if (fault := gloss_fault(angle, units)) is not None:
                raise ShapeError(f"{self.name}: {fault}")
        object.__setattr__(self, "texture", MappingProxyType(dict(self.texture)))
        object.__setattr__(self, "gloss", MappingProxyType(dict(self.gloss)))
        object.__setattr__(self, "notes", tuple(self.notes))

    def __repr__(self) -> str:
        return f"<Readings: {self.name}, {len(self)} of {self.instrument}, {self.bands}>"

    def __len__(self) -> int:
        """Return the number of direction pairs, P."""
        return int(self.wi.shape[0])

    @cached_property
    def bands(self) -> Bands:
        """The spectral axis."""
        return Bands.from_array(self.wavelengths_nm)

    @property
    def measured(self) -> Mask:
        """Return a mask of the values that were measured, bool, shape (P, B)."""
        return np.isfinite(self.values)

    def select_bands(self, bands: Sequence[int]) -> Readings:
        """Return the readings in some of their bands, given by increasing indices.

        Raises:
            ShapeError: the readings are RGB and a channel is missing, or the indices do not increase.
        """
        index = list(bands)
        if self.wavelengths_nm is None and index != [0, 1, 2]:
            raise ShapeError(f"{self.name}: bands {index} of linear sRGB, expected all three")
        nm = None if self.wavelengths_nm is None else self.wavelengths_nm[index]
        return replace(self, wavelengths_nm=nm, values=self.values[:, index])

    def select_pairs(self, pairs: Indices | Mask) -> Readings:
        """Return the readings at some of their pairs, by index (n,) or mask (P,), in the order given."""
        return replace(
            self,
            wi=self.wi[pairs],
            wo=self.wo[pairs],
            values=self.values[pairs],
            weights=self.weights[pairs],
            scatter=self.scatter[pairs],
        )

    @property
    def unit_note(self) -> str | None:
        """The note on the unit that was assumed; None if the file states it, or its format defines it."""
        return next((note for note in self.notes if note.startswith(NO_UNIT)), None)

    def in_unit(self, unit: str) -> Readings:
        """Return the readings with their values in another unit than was assumed.

        Raises:
            UsageError: the unit is unknown, or the file states its unit.
        """
        if unit not in UNITS:
            raise UsageError(f"no unit is called {unit!r}, expected one of {', '.join(UNITS)}")
        if self.assumed_unit is None:
            raise UsageError(f"{self.name}: {self.instrument} states its unit; leave --unit {unit} out")
        values = self.values * (UNITS[unit] / UNITS[self.assumed_unit])
        notes = tuple(note for note in self.notes if note != self.unit_note)
        return replace(self, values=values, notes=notes, assumed_unit=None)

    def seen_under(self, viewing: Viewing | None) -> Readings:
        """Return the readings with a light and observer that the user states; unchanged for None.

        Raises:
            UsageError: the file states another light or observer.
        """
        if viewing is None or viewing == self.viewing:
            return self
        if self.wavelengths_nm is None and not self.is_viewing_assumed:
            raise UsageError(
                f"{self.name}: colours under {self.viewing}, found {viewing}; leave --illuminant and --observer out"
            )
        return replace(self, viewing=viewing, is_viewing_assumed=False)

    def with_note(self, note: str) -> Readings:
        """Return the readings with one more note."""
        return replace(self, notes=(*self.notes, note))


def geometry_ma_t12() -> tuple[Array, Array]:
    """Return the 12 direction pairs of an MA-T12 (X-Rite): wi and wo, each (12, 3), in the order of `MA_T12_NAMES`.

    wi is the anchor leg, at 45 or 15 degrees and azimuth 180 degrees, so that the mirror direction lies at azimuth 0.
    """
    pairs = [aspecular_pair(anchor, aspecular) for anchor, aspecular in _MA_T12]
    return np.array([wi for wi, _ in pairs]), np.array([wo for _, wo in pairs])


def aspecular_pair(anchor_deg: float, aspecular_deg: float, azimuth_deg: float = 0.0) -> tuple[Array, Array]:
    """Return directions wi (3,) and wo (3,) from an anchor leg and an aspecular angle in degrees.

    The aspecular angle is counted from the mirror direction towards the normal. The azimuth turns it about the mirror
    direction and is 180 degrees towards the normal, as in X-Rite's names: `45as60az125.3` and `15as46.9az104.5` are
    the same detector, 45 degrees from the normal and across the plane of incidence.

    Source: ASTM E2194, E2539; geometries of the MA98.

    >>> wi, wo = aspecular_pair(45.0, 45.0)  # 45/0: the detector looks along the normal
    >>> bool(np.allclose(wo, [0.0, 0.0, 1.0]))
    True
    """
    wi = from_spherical(np.deg2rad(anchor_deg), np.pi)
    offset, azimuth = np.deg2rad(aspecular_deg), np.deg2rad(azimuth_deg)
    mirror = from_spherical(np.deg2rad(anchor_deg), 0.0)
    turned = from_spherical(np.deg2rad(anchor_deg - 90.0), 0.0)  # towards the normal
    if azimuth_deg % 180.0 != 0.0:
        turned = -np.cos(azimuth) * turned + np.sin(azimuth) * np.array([0.0, 1.0, 0.0])
    return wi, np.cos(offset) * mirror + np.sin(offset) * turned


def gloss_fault(angle_deg: float, units: float) -> str | None:
    """Return a text that says what is wrong with a gloss value at an angle; None if nothing is."""
    if angle_deg not in MOST_GLOSS:
        return f"gloss at {angle_deg:g} degrees, expected 20, 60 or 85 (ISO 2813)"
    most = MOST_GLOSS[angle_deg]
    if 0.0 <= units <= most:
        return None
    return (
        f"gloss of {units:g} units at {angle_deg:g} degrees, expected 0 to {most:g}, that of a perfect mirror"
    )


def mean_of_repeats(
    wi: Array, wo: Array, values: Array
) -> tuple[Array, Array, Array, Array, tuple[str, ...]]:
    """Return the mean of repeated readings, so that each direction pair appears once.

    The pairs are in order of their first appearance. Also return their scatter, and a note if any pair repeats.
    """
    keys = np.round(np.hstack([wi, wo]), 9)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.reshape(-1)
    if first.size == len(keys):
        return wi, wo, values, np.zeros(len(keys)), ()
    measured = np.isfinite(values)
    counts = np.zeros((first.size, values.shape[1]))
    np.add.at(counts, inverse, measured)

    def mean(of: Array) -> Array:
        totals = np.zeros_like(counts)
        np.add.at(totals, inverse, np.where(measured, of, 0.0))
        return np.divide(totals, counts, out=np.full_like(totals, np.nan), where=counts > 0)

    roots = np.cbrt(np.maximum(values, 0.0))
    of_pair = mean(roots)
    variance = mean((roots - of_pair[inverse]) ** 2) * counts / np.maximum(counts - 1.0, 1.0)
    norm = np.maximum(np.nansum(of_pair**2, axis=1), np.finfo(float).tiny)
    scatter = np.sqrt(np.nansum(variance, axis=1) / norm)
    order = np.argsort(first)
    count = len(keys) - first.size
    note = f"{counted(count, 'reading')} {'repeats' if count == 1 else 'repeat'} a geometry: means are taken"
    if scatter.max() > _CONTRADICTION:
        note += f", but they contradict each other, by up to {100.0 * scatter.max():.0f} % in cube roots"
    return wi[first[order]], wo[first[order]], mean(values)[order], scatter[order], (note,)


def _frozen(array: Array) -> Array:
    """Return a read-only contiguous copy."""
    copy = np.array(array, order="C")
    copy.flags.writeable = False
    return copy
