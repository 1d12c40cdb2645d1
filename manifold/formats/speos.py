"""Text files of Ansys Speos: `.brdf`, a table per incidence and wavelength, and `.anisotropicbsdf`, one per incidence.

Angles are in degrees, outgoing ones from the normal, with the mirror direction at azimuth 0. The anisotropy angle
is the azimuth from the direction in which light travels along the surface to the sample's x axis. Tables are
relative; percentages of reflected light scale them. A `.brdf` has one percentage per table, an `.anisotropicbsdf` one
spectrum at one incidence, which scales all tables.

Source: Ansys Speos, Labs user's guide, "Structure of BRDF files", "Structure of Anisotropic BSDF files".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold.core import disk
from manifold.core.defaults import GONIOMETER
from manifold.core.directions import from_spherical
from manifold.core.names import in_one_line
from manifold.core.records import Array
from manifold.formats.bsdf_text import Words, total_scatter, unique_directions
from manifold.formats.dense import DenseTable
from manifold.formats.quantities import LEAST_COSINE
from manifold.formats.readings import Readings
from manifold.formats.text import ErrorContext, read_bytes
from manifold.formats.values import unnamed_band

_REMEDY = "open the file in Speos' BSDF viewer and save it as text again"
_HEADER = re.compile(r"OPTIS - (brdf|anisotropic bsdf) surface file v(\d{1,3})", re.IGNORECASE)
_BREAK = re.compile(r"\r\n|\r|\n")
_OLDEST = 7  # the layout of older versions is not public
_FLAT_NM = (350, 850)  # ends of the spectrum of a single band, as in the files of Ansys' converters


class _Table(NamedTuple):
    """A table (T, P) proportional to f, its polar angles (T,) and azimuths (P,) in degrees, and its line."""

    theta: Array
    phi: Array
    f: Array
    where: str


class _Block(NamedTuple):
    """f in 1/sr, (T, P, B), of light from a polar angle, at an anisotropy angle; degrees."""

    theta_i: float
    turn: float
    theta: Array
    phi: Array
    f: Array


def sniff(head: bytes) -> bool:
    """Return whether a file has the beginning of these files."""
    return _HEADER.match(head.decode("latin-1")) is not None


def read(path: Path) -> list[Readings]:
    """Read the reflected light above the horizon."""
    context = ErrorContext(path, _REMEDY)
    head = re.split(_BREAK, read_bytes(path).decode("latin-1"), maxsplit=4)
    header = _HEADER.match(head[0])
    if header is None or len(head) < 5:
        raise context.error("the file ends within its first lines: it is cut off")
    if int(header[2]) < _OLDEST:
        expected = f"{_OLDEST} or newer: the layout of older ones is not public"
        raise context.error(f"version {header[2]}, expected {expected}")
    if head[1].strip() != "0":
        raise context.error(f"mode '{head[1].strip()[:12]}', expected 0, a text", "line 2")
    if not re.fullmatch(r"\s*\d{1,6}\s*", head[3]):
        raise context.error(f"'{head[3][:24]}', expected the number of letters of the description", "line 4")
    described = head[4][: int(head[3])]  # it may have several lines
    rest = re.split(_BREAK, head[4][len(described) :])[1:]
    words = Words(list(enumerate(rest, start=6 + len(_BREAK.findall(described)))), context)
    is_brdf = header[1].lower() == "brdf"
    if not is_brdf:
        words.numbers(3, "numbers of the anisotropy vector")
    has_reflection, has_transmission = words.numbers(2, "words whether there is reflection and transmission")
    if has_reflection != 1.0:
        raise context.error("transmission only, expected reflection")
    kind = words.number("1 for a BSDF or 0 for intensities")
    if kind not in (0.0, 1.0):
        raise context.error(f"found {kind:g}, expected 1 for a BSDF or 0 for intensities", words.line)
    is_bsdf = kind == 1.0
    notes = ["scaled to the percentages of reflected light that the file gives"]
    if has_transmission:
        notes.append("transmission is left out")
    nm, blocks = _brdf(words, is_bsdf) if is_brdf else _anisotropic(words, is_bsdf, has_transmission == 1.0)
    return [_readings(context, unnamed_band(notes, context) if nm is None else nm, blocks, notes)]


def _brdf(words: Words, is_bsdf: bool) -> tuple[Array | None, list[_Block]]:
    """Return wavelengths in nm, and a block per incidence."""
    n_theta, n_nm = words.count("incidences"), words.count("wavelengths")
    incidences, nm = words.increasing(n_theta, "incidences"), words.increasing(n_nm, "wavelengths")
    blocks = []
    for theta_i in incidences:
        tables, values = list[_Table](), list[Array]()
        for _ in nm:
            percent = words.number("percent of reflected light")
            tables.append(table := _table(words, is_bsdf))
            values.append(table.f * _scale(table, percent, words.context))
        theta, phi, _, where = tables[0]
        if any(not (np.array_equal(t.theta, theta) and np.array_equal(t.phi, phi)) for t in tables):
            raise words.context.error("other angles at other wavelengths, expected the same", where)
        blocks.append(_Block(theta_i, 0.0, theta, phi, np.stack(values, axis=-1)))
    return nm, blocks


def _anisotropic(words: Words, is_bsdf: bool, has_transmission: bool) -> tuple[Array | None, list[_Block]]:
    """Return wavelengths in nm, or None for one band, and a block per incidence and anisotropy angle."""
    sides = 2 if has_transmission else 1  # reflection first
    (turns, incidences), *_ = [_incidences(words) for _ in range(sides)]
    (at, nm, percent), *_ = [_spectrum(words) for _ in range(sides)]
    if at[1] not in turns:
        raise words.context.error(f"a spectrum at anisotropy angle {at[1]:g}, expected one of the tables'")
    found = [(t, k, _table(words, is_bsdf)) for t, own in zip(turns, incidences, strict=True) for k in own]
    scales = [_scale(table, 1.0, words.context) for turn, _, table in found if turn == at[1]]
    scale = percent * np.interp(at[0], incidences[list(turns).index(at[1])], scales)
    is_flat = np.ptp(percent) == 0.0  # neutral samples have one band
    scale = scale[:1] if is_flat else scale
    blocks = [_Block(k, t, table.theta, table.phi, table.f[..., None] * scale) for t, k, table in found]
    return None if is_flat else nm, blocks


def _incidences(words: Words) -> tuple[Array, list[Array]]:
    """Return the anisotropy angles, and the polar angles of incidence at each."""
    turns = words.angles("anisotropy")
    return turns, [words.angles("incidence") for _ in turns]


def _spectrum(words: Words) -> tuple[Array, Array, Array]:
    """Return polar angle and anisotropy angle of the measurement, wavelengths in nm, and percentages of light."""
    at = words.numbers(2, "angles of the spectrum")
    words.rest()  # its title, which may be empty
    count = words.count("wavelengths")
    nm, percent = words.numbers(2 * count, "wavelengths and percentages").reshape(-1, 2).T
    if np.any(np.diff(nm) <= 0.0):
        raise words.context.error("wavelengths do not increase, expected increasing ones", words.line)
    return at, nm, percent


def _table(words: Words, is_bsdf: bool) -> _Table:
    """Parse counts of polar angles and azimuths, the azimuths, and rows of a polar angle and its values."""
    where = words.line
    n_theta, n_phi = words.count("elevations"), words.count("azimuths")
    phi = words.increasing(n_phi, "azimuths")
    rows = words.numbers(n_theta * (n_phi + 1), "values of a table").reshape(n_theta, n_phi + 1)
    theta, f = rows[:, 0], rows[:, 1:]
    if np.any(np.diff(theta) <= 0.0) or theta[0] < 0.0 or not np.isclose(phi[-1] - phi[0], 360.0):
        raise words.context.error("expected elevations that increase, and azimuths of a full turn", where)
    if not is_bsdf:  # intensities
        f = f / np.maximum(np.cos(np.deg2rad(theta)), LEAST_COSINE)[:, None]
    return _Table(theta, phi, f, where)


def _scale(table: _Table, percent: float, context: ErrorContext) -> float:
    """Return the factor with which a table reflects a percentage of light."""
    reflected = _reflected(table.theta, table.phi, table.f)
    if not 0.0 <= percent <= 1000.0 or (percent > 0.0 and reflected <= 0.0):
        found = f"{percent:g} % of light is reflected by a table whose integral is {reflected:g}"
        raise context.error(f"{found}, expected 0 to 100", table.where)
    return percent / (100.0 * reflected) if percent else 0.0


def _reflected(theta: Array, phi: Array, f: Array) -> float:
    """Return the fraction of light that f (T, P) reflects, at angles in degrees, by the trapezoidal rule."""
    theta, phi = np.deg2rad(theta), np.deg2rad(phi)
    return total_scatter(f.T, phi, theta, np.cos(theta))


def _readings(context: ErrorContext, nm: Array, blocks: list[_Block], notes: list[str]) -> Readings:
    if any(not 0.0 <= block.theta_i <= 90.0 for block in blocks):
        raise context.error("an incidence beyond 90 degrees, expected reflected light")
    wi, wo, values = [], [], []
    by_angles = {(block.theta_i, block.turn % 360.0): block for block in blocks}  # 360 degrees are 0
    for block in by_angles.values():
        azimuth, radial, rows = unique_directions(block.phi, block.theta)
        out = from_spherical(np.deg2rad(radial), np.deg2rad(azimuth - block.turn))
        above = out[:, 2] > LEAST_COSINE
        light = from_spherical(np.deg2rad(block.theta_i), np.deg2rad(180.0 - block.turn))
        wi.append(np.tile(np.maximum(light, [-1.0, -1.0, 0.0]), (int(above.sum()), 1)))
        wo.append(out[above])
        values.append(np.swapaxes(block.f, 0, 1).reshape(-1, block.f.shape[-1])[rows][above])
    all_wi, all_wo, f = (np.concatenate(arrays) for arrays in (wi, wo, values))
    return Readings(
        context.path.stem, "Ansys Speos", all_wi, all_wo, nm, f, notes=tuple(notes), repeatability=GONIOMETER
    )


def write(path: Path, table: DenseTable) -> None:
    """Write a `.brdf` of an isotropic spectral table of incident and outgoing angles, with light at 180 degrees."""
    theta_i, _, theta, phi = (np.rad2deg(axis) for axis in table.axes)
    nm = table.bands.wavelengths_nm or ()
    lines = [
        *_head("brdf", table.name), "1\t0", "1", f"{theta_i.size}\t{len(nm)}", _row(theta_i), _row(np.array(nm)),
    ]  # fmt: skip
    for block in table.values[:, 0]:
        for f in np.moveaxis(block, -1, 0):
            reflected, rows = _table_lines(theta, phi, f)
            lines += [f"{100.0 * reflected:.9g}", *rows]
    disk.write_text(path, "\n".join([*lines, "End of file"]) + "\n")


def write_anisotropic(path: Path, table: DenseTable) -> None:
    """Write an `.anisotropicbsdf` of one band; the incident azimuths must be among the outgoing ones."""
    theta_i, phi_i, theta, phi = (np.rad2deg(axis) for axis in table.axes)
    turns = np.mod(180.0 - phi_i, 360.0)
    blocks, order = [], np.argsort(turns)
    for j in order:
        shift = int(np.argmin(np.abs(phi - turns[j])))
        blocks += [_table_lines(theta, phi, np.roll(f[..., 0], shift, axis=1)) for f in table.values[:, j]]
    lines = [
        *_head("Anisotropic BSDF", table.name),
        "1\t0\t0",
        "1\t0",
        "1",
        f"{turns.size}",
        _row(turns[order]),
    ]
    lines += [f"{theta_i.size}", _row(theta_i)] * turns.size
    percent = 100.0 * blocks[0][0]
    lines += [f"{theta_i[0]:.6g}\t{turns[order[0]]:.6g}", "Reflection", "2"]
    lines += [f"{nm}\t{percent:.9g}" for nm in _FLAT_NM]
    lines += [line for _, rows in blocks for line in rows]
    disk.write_text(path, "\n".join([*lines, "End of file"]) + "\n")


def _head(kind: str, name: str) -> list[str]:
    """Return the first lines: version, text, comment, and the letters of a description that has none."""
    return [f"OPTIS - {kind} surface file v8.0", "0", in_one_line(name), "0", ""]


def _table_lines(theta: Array, phi: Array, f: Array) -> tuple[float, list[str]]:
    """Return the fraction of light that f (T, P) reflects, and its table's lines, closed at the horizon and at 360."""
    f = np.maximum(np.hstack([f, f[:, :1]]), 0.0)
    phi = np.append(phi, phi[0] + 360.0)
    if theta[-1] < 90.0:
        theta, f = np.append(theta, 90.0), np.vstack([f, f[-1:]])
    rows = [f"{t:.6g}\t{_row(row)}" for t, row in zip(theta, f, strict=True)]
    return _reflected(theta, phi, f), [f"{theta.size} {phi.size}", "\t" + _row(phi), *rows]


def _row(values: Array) -> str:
    return "\t".join(f"{value:.7g}" for value in values)
