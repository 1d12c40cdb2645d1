"""Writes the formats of `manifold convert`, by sampling a BRDF at the nodes of each format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from manifold import __version__
from manifold.brdf import goniometer
from manifold.brdf.unmeasured_cells import LEAST_COSINE, STEEPEST
from manifold.convert.source import ConversionSource
from manifold.core.defaults import CONVERTED_RESOLUTION
from manifold.core.directions import from_spherical, rotate_z
from manifold.core.errors import UsageError
from manifold.core.names import percent
from manifold.core.pairs import LEVEL, RusinkiewiczGrid
from manifold.core.records import Array
from manifold.formats import (
    astm,
    bird,
    csv_table,
    fred,
    lighttools,
    mbsdf,
    merl,
    openmaterial,
    speos,
    utia,
    zemax,
)
from manifold.formats.dense import DenseTable
from manifold.formats.readings import Readings
from manifold.io_rgl import write_bsdf
from manifold.registries import CONVERTED, CONVERTED_IN_WORDS, CONVERTED_SUFFIXES

_BLOCK = 65536  # pairs evaluated at once
_TURNS = 8  # rotations of an anisotropic sample that an isotropic format averages over
_MOST_INCIDENCES = 40
_MEASURED_WITHIN = np.deg2rad(0.5)  # angle from a measured incidence: half a step of MERL's
_FINE, _MEDIUM, _COARSE = (1.0, 5.0), (2.0, 10.0), (5.0, 15.0)  # degrees of polar angle and azimuth
_AZIMUTHS = np.deg2rad(np.arange(0.0, 360.0, 30.0))  # of incidence on an anisotropic sample
_USUAL_INCIDENCES = np.deg2rad([0, 10, 20, 30, 40, 50, 60, 70, 80, 85])


Holds = Literal["any", "RGB", "RGB or one", "one", "wavelengths"]
"""The kinds of bands that a format can hold."""


Write = Callable[[Path, "ConversionSource", "Options"], list[str]]


class WrittenFormat(NamedTuple):
    """A format to write: its title, its suffixes, the bands that it can hold, and the function that writes it.

    The function writes a source and returns notes on omitted data. `keeps` names further data of readings that the
    format holds.
    """

    title: str
    suffixes: tuple[str, ...]
    holds: Holds
    write: Write
    keeps: tuple[str, ...] = ()

    def left_out(self, readings: Readings) -> list[str]:
        """Return a note about data of readings, other than values, that the format cannot hold."""
        said = {
            "weights": np.ptp(readings.weights) > 0.0,
            "uncertainties": np.any(readings.scatter > 0.0),
            "gloss": readings.gloss,
            "texture": readings.texture,
        }
        lost = [name for name, is_said in said.items() if is_said and name not in self.keeps]
        return [f"left out, because {self.title} cannot store them: {', '.join(lost)}"] if lost else []


class Options(NamedTuple):
    """The grid of a written RGL file; without options, an RGL file is copied byte for byte.

    Attributes:
        resolution: nodes per axis of its outgoing grid; None is `CONVERTED_RESOLUTION`.
        n_theta_i: number of angles of incidence in addition to those of the file; by default 16, or 48 if the file
            has none.
    """

    resolution: int | None = None
    n_theta_i: int | None = None


def _write_rgl(path: Path, source: ConversionSource, options: Options) -> list[str]:
    if source.file is not None and options == Options():
        write_bsdf(path, source.file)
        return []
    brdf = source.brdf
    own = source.theta_i_rad[source.theta_i_rad < np.deg2rad(89.0)]
    if own.size > _MOST_INCIDENCES:
        own = own[:0]
    spread: Array = goniometer.default_theta_i(options.n_theta_i or (16 if own.size else 48))
    # The file's own incidences stay; others fill the gaps, none so near that it adds nothing.
    others = [t for t in spread if not own.size or np.min(np.abs(own - t)) > 0.4 * (spread[1] - spread[0])]
    theta_i: Array = np.unique(np.concatenate([own, others, spread[[0, -1]]]))
    file = goniometer.measure(
        brdf, source.nodes.name, description=f"Converted from {source.nodes.instrument} by manifold {__version__}",
        resolution=options.resolution or CONVERTED_RESOLUTION, theta_i_rad=theta_i, compensate=False,
        bend=goniometer.SOFT_BEND,
    )  # fmt: skip
    write_bsdf(path, file)
    return []


def _write_merl(path: Path, source: ConversionSource, options: Options) -> list[str]:
    turns, notes = _turns(source, "MERL")
    values = np.full((np.prod(merl.SHAPE), 3), np.nan)
    start = 0
    for wi, wo, above in RusinkiewiczGrid(*merl.SHAPE, squared_theta_h=True, offset=0.0).blocks(_BLOCK):
        values[start : start + len(wi)][above] = _reciprocal(source, wi[above], wo[above], turns)
        start += len(wi)
    negative = int(np.any(values < 0.0, axis=1).sum())
    if negative:
        notes.append(f"{negative} nodes have a negative channel (colours outside sRGB, noise), stored as 0")
    table = DenseTable(
        source.nodes.name, "MERL", "half-difference", merl.axes(), None, values.reshape(*merl.SHAPE, 3)
    )
    merl.write(path, table)
    return notes


def _write_mbsdf(path: Path, source: ConversionSource, options: Options) -> list[str]:
    turns, notes = _turns(source, "MBSDF")
    axes = mbsdf.axes()
    theta_i, _, theta_o, phi = axes
    values = np.zeros((theta_i.size, 1, theta_o.size, phi.size, 3))
    half, wo = phi.size // 2, from_spherical(theta_o[:, None], phi)
    for i, theta in enumerate(theta_i):
        pairs = np.broadcast_arrays(from_spherical(theta, 0.0), wo)
        wi, wo_flat = (w.reshape(-1, 3) for w in pairs)
        block = _reciprocal(source, wi, wo_flat, turns).reshape(wo.shape)
        values[i, 0, :, :half] = 0.5 * (block[:, :half] + block[:, half:][:, ::-1])  # both sides of the plane
    mbsdf.write(path, DenseTable(source.nodes.name, "MBSDF", "incident-outgoing", axes, None, values))
    return notes


def _turns(source: ConversionSource, title: str) -> tuple[Array, list[str]]:
    """Return the rotations of the sample over which an isotropic format averages, in radians, and a note on them."""
    if source.brdf.is_isotropic:
        return np.zeros(1), []
    note = f"{title} is isotropic: {_TURNS} rotations of the sample are averaged"
    return np.arange(float(_TURNS)) * (2.0 * np.pi / _TURNS), [note]


def _reciprocal(source: ConversionSource, wi: Array, wo: Array, turns: Array) -> Array:
    """Return the mean over rotations, and over both directions of the light, for pairs (n, 3); shape (n, B).

    Of the directions, the one nearer to a measured incidence counts more.
    """
    total = np.zeros((len(wi), source.brdf.bands.count))
    for turn in turns:
        a, b = (rotate_z(w, turn) for w in (wi, wo))
        share = _share(a, b, source)[:, None]
        total += (share * _eval(source, a, b) + (1.0 - share) * _eval(source, b, a)) / turns.size
    return total


def _share(a: Array, b: Array, source: ConversionSource) -> Array:
    """Return the weight (n,) of f(a, b) beside f(b, a) for pairs (n, 3).

    The weight is 1/2, except that for readings the direction nearer to a measured incidence weighs more.
    """
    if not source.is_readings:
        return np.full(len(a), 0.5)
    to_a, to_b = (
        np.min(np.abs(np.arccos(np.clip(w[:, 2:], 0.0, 1.0)) - source.theta_i_rad), axis=1) ** 2
        + _MEASURED_WITHIN**2
        for w in (a, b)
    )
    return np.asarray(to_b / (to_a + to_b))


def _write_utia(path: Path, source: ConversionSource, options: Options) -> list[str]:
    utia.write(path, _sampled(source, utia.axes()))
    lowest = np.cos(utia.axes()[0][-1]) - 1e-6
    beyond = (np.minimum(source.nodes.wi[:, 2], source.nodes.wo[:, 2]) < lowest).mean()
    note = f"UTIA ends at 75 degrees: {percent(beyond)} of the nodes lie beyond and take its last values"
    return [note] if beyond else []


def _write_lighttools(path: Path, source: ConversionSource, options: Options) -> list[str]:
    lighttools.write(path, _about_the_normal(source, _FINE if source.nodes.bands.count <= 31 else _MEDIUM))
    return []


def _write_fred(path: Path, source: ConversionSource, options: Options) -> list[str]:
    fred.write(path, _about_the_normal(source, _FINE if source.brdf.is_isotropic else _MEDIUM))
    return []


def _write_speos(path: Path, source: ConversionSource, options: Options) -> list[str]:
    steps = _FINE if source.nodes.bands.count <= 31 else _MEDIUM
    speos.write(path, _about_the_normal(source, steps, one_turn=True))
    return _one_turn(source)


def _write_speos_anisotropic(path: Path, source: ConversionSource, options: Options) -> list[str]:
    speos.write_anisotropic(path, _about_the_normal(source, _FINE))
    return []


def _write_openmaterial(path: Path, source: ConversionSource, options: Options) -> list[str]:
    count = source.nodes.bands.count  # a row per value: a million of them are 45 MB
    steps = _FINE if count <= 3 else _MEDIUM if count <= 31 else _COARSE
    openmaterial.write(path, _about_the_normal(source, steps, one_turn=True))
    return [
        *_one_turn(source),
        "fill in copyright, license and authors, which are 'not stated'",
    ]


def _one_turn(source: ConversionSource) -> list[str]:
    return (
        [] if source.brdf.is_isotropic else ["one rotation of the sample is written: the format is isotropic"]
    )


def _about_the_normal(
    source: ConversionSource, steps: tuple[float, float], *, one_turn: bool = False
) -> DenseTable:
    """Sample the BRDF at its incidences, and at polar angles and azimuths about the normal, by steps in degrees."""
    radial = np.deg2rad(np.append(np.arange(0.0, 89.0, steps[0]), 89.0))
    azimuth = np.deg2rad(np.arange(0.0, 360.0, steps[1]))
    is_one = one_turn or source.brdf.is_isotropic
    phi_i = np.array([np.pi]) if is_one else _AZIMUTHS
    return _sampled(source, (_incidences(source), phi_i, radial, azimuth))


def _write_zemax(path: Path, source: ConversionSource, options: Options) -> list[str]:
    brdf, theta_i = source.brdf, _incidences(source)
    rotation = np.zeros(1) if brdf.is_isotropic else _AZIMUTHS
    azimuth = np.deg2rad(np.arange(0.0, 361.0, 5.0 if brdf.is_isotropic else 10.0))
    # Dense around the mirror direction.
    radial = np.deg2rad(
        np.concatenate([np.arange(0, 20, 0.5), np.arange(20, 90, 1.0), np.arange(90, 176, 5.0)])
    )
    values = np.zeros((rotation.size, theta_i.size, azimuth.size, radial.size, brdf.bands.count))
    for k, turn in enumerate(rotation):
        for block, theta in zip(values[k], theta_i, strict=True):
            block[:] = _eval(source, *zemax.directions(theta, radial[None, :], azimuth[:, None], turn))
    zemax.write(path, source.nodes.name, theta_i, azimuth, radial, values, rotation)
    return []


def _write_astm(path: Path, source: ConversionSource, options: Options) -> list[str]:
    rows = _rows(source)
    whole = np.asarray(rows.measured.all(axis=1))
    if not np.any(whole):
        raise UsageError(
            f"{rows.name}: no direction was measured in all bands, which an ASTM table needs; write CSV"
        )
    astm.write(path, rows.select_pairs(whole))
    left_out = int((~whole).sum())
    return [f"{left_out} directions not measured in all bands are left out"] if left_out else []


def _write_csv(path: Path, source: ConversionSource, options: Options) -> list[str]:
    csv_table.write(path, _rows(source))
    return []


def _write_bird(path: Path, source: ConversionSource, options: Options) -> list[str]:
    rows = _rows(source)
    is_estimated = source.file is not None and source.file.origin != "measured"
    bird.write(path, rows, "simulation" if is_estimated else "measurement")
    notes = ["fill in organisation, contact, place, instrument and time, which are 'not stated' or 'NA'"]
    if np.any(rows.scatter > 0.0):
        of = (
            "as the file says"
            if source.expected_error is None
            else "three times the expected cube-root error"
        )
        notes.append(
            f"relative uncertainties are {of} (median {300.0 * float(np.median(rows.scatter)):.2g} %)"
        )
    return notes


def _rows(source: ConversionSource) -> Readings:
    """Return the readings themselves, or the BRDF at the directions of a goniometer."""
    if source.is_readings:
        return source.nodes
    brdf = source.brdf
    theta = np.deg2rad(np.append(np.arange(2.0, 89.0, 2.0), 89.0))
    phi = np.deg2rad(np.arange(0.0, 360.0, 10.0))
    grid = from_spherical(theta[:, None], phi[None, :]).reshape(-1, 3)
    wo = np.concatenate([[[0.0, 0.0, 1.0]], grid])
    phi_i = [np.pi] if brdf.is_isotropic else _AZIMUTHS
    wi = np.array([from_spherical(t, p) for t in _incidences(source) for p in phi_i])
    values = np.concatenate([_eval(source, w, wo) for w in wi])
    nodes = source.nodes
    return Readings(
        nodes.name, nodes.instrument, np.repeat(wi, len(wo), axis=0), np.tile(wo, (len(wi), 1)), nodes.wavelengths_nm,
        values, scatter=np.full(len(values), source.expected_error or 0.0),
    )  # fmt: skip


def _sampled(source: ConversionSource, axes: tuple[Array, Array, Array, Array]) -> DenseTable:
    """Sample the BRDF at the product of incident and outgoing angles."""
    brdf = source.brdf
    theta_i, phi_i, theta_o, phi_o = axes
    wo = from_spherical(theta_o[:, None], phi_o[None, :])
    values = np.zeros((*(a.size for a in axes), brdf.bands.count))
    for i, j in np.ndindex(theta_i.size, phi_i.size):
        values[i, j] = _eval(source, from_spherical(theta_i[i], phi_i[j]), wo)
    nodes = source.nodes
    return DenseTable(nodes.name, nodes.instrument, "incident-outgoing", axes, nodes.wavelengths_nm, values)


def _incidences(source: ConversionSource) -> Array:
    """Return the file's own polar angles of incidence, or usual ones if it has none or very many."""
    own = source.theta_i_rad[source.theta_i_rad <= STEEPEST]
    return own if 2 <= own.size <= _MOST_INCIDENCES else _USUAL_INCIDENCES


def _eval(source: ConversionSource, wi: Array, wo: Array) -> Array:
    """Return f in 1/sr, shape (..., B).

    Directions closer to the horizon than RGL files reach get the values at two degrees above it.
    """
    if source.file is not None:
        wi, wo = _off_horizon(wi), _off_horizon(wo)
    return source.brdf.eval(wi, wo)


def _off_horizon(w: Array) -> Array:
    """Lift directions (..., 3) between the horizon, within rounding, and `LEAST_COSINE` to the latter."""
    low = (w[..., 2] > -LEVEL) & (w[..., 2] < LEAST_COSINE)
    lifted = w.copy()
    lifted[low, :2] *= np.sqrt(1.0 - LEAST_COSINE**2) / np.hypot(w[low, 0], w[low, 1])[:, None]
    lifted[low, 2] = LEAST_COSINE
    return lifted


def _target(name: str, title: str, holds: Holds, write: Write, keeps: tuple[str, ...] = ()) -> WrittenFormat:
    return WrittenFormat(title, CONVERTED_SUFFIXES[name], holds, write, keeps)


RGL = _target("rgl", "RGL file", "any", _write_rgl)
MERL = _target("merl", "MERL", "RGB", _write_merl)
MBSDF = _target("mbsdf", "MBSDF", "RGB", _write_mbsdf)
UTIA = _target("utia", "UTIA", "RGB", _write_utia)
LIGHTTOOLS = _target("lighttools", "LightTools BSDF text", "any", _write_lighttools)
ZEMAX = _target("zemax", "Zemax BSDF text", "RGB or one", _write_zemax)
FRED = _target("fred", "FRED table", "one", _write_fred)
SPEOS = _target("speos", "Ansys Speos BRDF", "wavelengths", _write_speos)
SPEOS_ANISOTROPIC = _target(
    "speos-anisotropic", "Ansys Speos anisotropic BSDF", "one", _write_speos_anisotropic
)
OPENMATERIAL = _target("openmaterial", "OpenMATERIAL 3D", "wavelengths", _write_openmaterial)
BIRD = _target("bird", "BiRD JSON", "wavelengths", _write_bird, ("uncertainties",))
ASTM = _target("astm", "ASTM table", "any", _write_astm)
CSV = _target("csv", "CSV table", "any", _write_csv, ("weights", "uncertainties", "gloss"))


def target_of(output: Path, to: str | None) -> WrittenFormat:
    """Return the format to write: `to`, one of `CONVERTED`, or the one that the suffix of the output denotes."""
    if to is not None:
        return CONVERTED[to]
    by_suffix = {suffix: target for target in CONVERTED.values() for suffix in target.suffixes}
    suffix = output.suffix.lower()
    if suffix not in by_suffix:
        raise UsageError(
            f"{output}: suffix '{suffix}', expected one of {CONVERTED_IN_WORDS}; or name one of the formats {CONVERTED}"
        )
    return by_suffix[suffix]
