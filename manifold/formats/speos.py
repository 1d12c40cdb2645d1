"""Text files of Ansys Speos: `.brdf`, a table per incidence and wavelength, and `.anisotropicbsdf`, one per incidence.

Degrees; outgoing angles about the normal, the mirror direction at azimuth 0. The anisotropy angle turns the direction
in which light travels along the surface into the sample's x axis. Tables are relative, scaled by percentages of
reflected light: a `.brdf` has one for each, an `.anisotropicbsdf` a spectrum at one incidence, which scales all.

Source: Ansys Speos, Labs user's guide, "Structure of BRDF files", "Structure of Anisotropic BSDF files".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold.directions import from_spherical
from manifold.formats.bsdf_text import unique_directions
from manifold.formats.dense import DenseTable
from manifold.formats.error_context import ErrorContext
from manifold.formats.readings import Readings
from manifold.formats.text import read_bytes
from manifold.formats.values import unnamed_band
from manifold.records import Array
from manifold.system import atomic
from manifold.system.names import in_one_line

_REMEDY = "open the file in Speos' BSDF viewer and save it as text again"
_HEADER = re.compile(r"OPTIS - (brdf|anisotropic bsdf) surface file v(\d{1,3})", re.IGNORECASE)
_BREAK = re.compile(r"\r\n|\r|\n")
_OLDEST = 7  # the layout of older versions is not public
_MOST = 2000  # angles, wavelengths
_INCIDENCES = "angles of incidence"
_LEAST_COSINE = 1e-3  # nothing is measured nearer to the horizon
_FLAT_NM = (350, 850)  # ends of the spectrum of a single band, as in the files of Ansys' converters


class _Table(NamedTuple):
    """What is proportional to f, (T, P), at elevations (T,) and azimuths (P,) in degrees, a full turn; and its line."""

    theta: Array
    phi: Array
    f: Array
    where: str


class _Block(NamedTuple):
    """f in 1/sr, (T, P, B), of light from an elevation, at an anisotropy angle; degrees."""

    theta_i: float
    turn: float
    theta: Array
    phi: Array
    f: Array


class _Lines:
    """The lines of a file in turn, each with its number."""

    def __init__(self, lines: list[str], first: int, context: ErrorContext) -> None:
        self._lines, self._next, self._first, self.context = lines, 0, first, context

    @property
    def number(self) -> int:
        """Of the line that comes next."""
        return self._first + self._next

    def text(self, what: str) -> str:
        """The next line."""
        if self._next >= len(self._lines):
            raise self.context.error(f"the file ends, expected {what}: it is cut off")
        self._next += 1
        return self._lines[self._next - 1]

    def row(self, count: int, what: str) -> list[float]:
        """The next line's numbers."""
        number, cells = self.number, self.text(what).split()
        if len(cells) != count:
            raise self.context.error(f"{len(cells)} cells, expected {count}: {what}", f"line {number}")
        return self.context.numbers(cells, number)

    def counts(self, number: int, what: str) -> list[int]:
        """The next line's whole numbers from 1."""
        where = f"line {self.number}, {what}"
        return [self.context.count(f"{value:.9g}", where, _MOST) for value in self.row(number, what)]

    def increasing(self, count: int, what: str, most: float = 360.0) -> Array:
        """The next line's numbers, from 0 to `most`, which increase."""
        where, values = f"line {self.number}", np.array(self.row(count, what))
        if np.any(np.diff(values) <= 0.0) or values[0] < 0.0 or values[-1] > most:
            raise self.context.error(f"{what}: expected ordered numbers from 0 to {most:g}", where)
        return values

    def incidences(self) -> tuple[Array, list[Array]]:
        """Anisotropy angles, and the elevations of incidence at each."""
        turns = self._list("anisotropy angles", 360.0)
        return turns, [self._list(_INCIDENCES, 90.0) for _ in turns]

    def _list(self, what: str, most: float) -> Array:
        (count,) = self.counts(1, f"the count of {what}")
        return self.increasing(count, what, most)

    def spectrum(self) -> tuple[list[float], Array, Array]:
        """Elevation and anisotropy angle where it was measured, wavelengths in nm, and percentages of light."""
        at = self.row(2, "theta and phi of the spectrum")
        self.text("a title of the spectrum")
        (count,) = self.counts(1, "the count of wavelengths")
        nm, percent = np.array([self.row(2, "a wavelength and its percentage") for _ in range(count)]).T
        if np.any(np.diff(nm) <= 0.0):
            raise self.context.error(
                "wavelengths do not increase, expected them ordered", f"line {self.number}"
            )
        return at, nm, percent

    def table(self, is_bsdf: bool) -> _Table:
        """Counts of elevations and azimuths, the azimuths, and lines of an elevation and its values."""
        where = f"line {self.number}"
        n_theta, n_phi = self.counts(2, "counts of theta and phi")
        phi = self.increasing(n_phi, "azimuths")
        rows = np.array([self.row(n_phi + 1, "theta and its values") for _ in range(n_theta)])
        theta, f = rows[:, 0], rows[:, 1:]
        if np.any(np.diff(theta) <= 0.0) or theta[0] < 0.0 or phi[-1] - phi[0] < 359.999:
            raise self.context.error("expected elevations and azimuths that increase, and a full turn", where)
        if not is_bsdf:  # intensities
            f = f / np.maximum(np.cos(np.deg2rad(theta)), _LEAST_COSINE)[:, None]
        return _Table(theta, phi, f, where)

    def scale(self, table: _Table, percent: float) -> float:
        """The factor with which a table reflects a percentage of light."""
        reflected = _reflected(table.theta, table.phi, table.f)
        if not 0.0 <= percent <= 1000.0 or (percent > 0.0 and reflected <= 0.0):
            found = f"{percent:g} % of light is reflected by a table whose integral is {reflected:g}"
            raise self.context.error(f"{found}, expected 0 to 100", table.where)
        return percent / (100.0 * reflected) if percent else 0.0


def sniff(head: bytes) -> bool:
    """Whether a file begins as these do."""
    return _HEADER.match(head.decode("latin-1")) is not None


def read(path: Path) -> list[Readings]:
    """Readings of reflected light above the horizon.

    Raises:
        FileFormatError: a binary file, one older than version 7, one of transmission only, or lists and tables that are
            cut off or hold what is no number.
        UsageError: the file cannot be read.
    """
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
    number = 6 + len(_BREAK.findall(described))
    lines = _Lines(re.split(_BREAK, head[4][len(described) :])[1:], number, context)
    is_brdf = header[1].lower() == "brdf"
    if not is_brdf:
        lines.row(3, "the anisotropy vector")
    has_reflection, has_transmission = lines.row(2, "whether there is reflection and transmission")
    if has_reflection != 1.0:
        raise context.error("transmission only, expected reflection")
    is_bsdf = lines.row(1, "1 for a BSDF or 0 for intensities") == [1.0]
    notes = ["scaled to the percentages of reflected light that the file gives"]
    if has_transmission:
        notes.append("transmission is left out")
    nm, blocks = _brdf(lines, is_bsdf) if is_brdf else _anisotropic(lines, is_bsdf, has_transmission == 1.0)
    return [_readings(path.stem, unnamed_band(notes) if nm is None else nm, blocks, notes)]


def _brdf(lines: _Lines, is_bsdf: bool) -> tuple[Array | None, list[_Block]]:
    """Wavelengths in nm, and a block per incidence."""
    n_theta, n_nm = lines.counts(2, "counts of incidences and wavelengths")
    incidences = lines.increasing(n_theta, _INCIDENCES, 90.0)
    nm = lines.increasing(n_nm, "wavelengths", 1e6)
    blocks = []
    for theta_i in incidences:
        tables, values = list[_Table](), list[Array]()
        for _ in nm:
            (percent,) = lines.row(1, "percent of reflected light")
            tables.append(table := lines.table(is_bsdf))
            values.append(table.f * lines.scale(table, percent))
        theta, phi, _, where = tables[0]
        if any(not (np.array_equal(t.theta, theta) and np.array_equal(t.phi, phi)) for t in tables):
            raise lines.context.error("other angles at other wavelengths, expected the same", where)
        blocks.append(_Block(theta_i, 0.0, theta, phi, np.stack(values, axis=-1)))
    return nm, blocks


def _anisotropic(lines: _Lines, is_bsdf: bool, has_transmission: bool) -> tuple[Array | None, list[_Block]]:
    """Wavelengths in nm, or None for one band, and a block per incidence and anisotropy angle."""
    turns, incidences = lines.incidences()
    if has_transmission:
        lines.incidences()
    (theta_0, turn_0), nm, percent = lines.spectrum()
    if has_transmission:
        lines.spectrum()
    if turn_0 not in turns:
        raise lines.context.error(f"a spectrum at anisotropy angle {turn_0:g}, expected one of the tables'")
    found = [(t, k, lines.table(is_bsdf)) for t, own in zip(turns, incidences, strict=True) for k in own]
    scales = [lines.scale(table, 1.0) for turn, _, table in found if turn == turn_0]
    scale = percent * np.interp(theta_0, incidences[list(turns).index(turn_0)], scales)
    is_flat = np.ptp(percent) == 0.0  # what has no colour is one band
    scale = scale[:1] if is_flat else scale
    blocks = [_Block(k, t, table.theta, table.phi, table.f[..., None] * scale) for t, k, table in found]
    return None if is_flat else nm, blocks


def _reflected(theta: Array, phi: Array, f: Array) -> float:
    """The fraction of light that f (T, P) reflects, at angles in degrees, by the trapezoidal rule."""
    theta, phi = np.deg2rad(theta), np.deg2rad(phi)
    around = np.trapezoid(f, phi, axis=1)
    return float(np.trapezoid(around * np.sin(theta) * np.maximum(np.cos(theta), 0.0), theta))


def _readings(name: str, nm: Array, blocks: list[_Block], notes: list[str]) -> Readings:
    wi, wo, values = [], [], []
    for block in {
        (block.theta_i, block.turn % 360.0): block for block in blocks
    }.values():  # 360 degrees are 0
        azimuth, radial, rows = unique_directions(block.phi, block.theta)
        out = from_spherical(np.deg2rad(radial), np.deg2rad(azimuth - block.turn))
        above = out[:, 2] > _LEAST_COSINE
        light = from_spherical(np.deg2rad(block.theta_i), np.deg2rad(180.0 - block.turn))
        wi.append(np.tile(np.maximum(light, [-1.0, -1.0, 0.0]), (int(above.sum()), 1)))
        wo.append(out[above])
        values.append(np.swapaxes(block.f, 0, 1).reshape(-1, block.f.shape[-1])[rows][above])
    all_wi, all_wo, f = (np.concatenate(arrays) for arrays in (wi, wo, values))
    return Readings(name, "Ansys Speos", all_wi, all_wo, nm, f, notes=tuple(notes))


def write(path: Path, table: DenseTable) -> None:
    """A `.brdf` of an isotropic sample.

    Args:
        path: where to.
        table: of incident and outgoing angles, light at azimuth 180 degrees; it has wavelengths.
    """
    theta_i, _, theta, phi = (np.rad2deg(axis) for axis in table.axes)
    nm = table.bands.wavelengths_nm or ()
    lines = [
        *_head("brdf", table.name), "1\t0", "1", f"{theta_i.size}\t{len(nm)}", _row(theta_i), _row(np.array(nm)),
    ]  # fmt: skip
    for block in table.values[:, 0]:
        for f in np.moveaxis(block, -1, 0):
            reflected, rows = _table_lines(theta, phi, f)
            lines += [f"{100.0 * reflected:.9g}", *rows]
    atomic.write_text(path, "\n".join([*lines, "End of file"]) + "\n")


def write_anisotropic(path: Path, table: DenseTable) -> None:
    """An `.anisotropicbsdf` of one band, isotropic or not.

    Args:
        path: where to.
        table: of incident and outgoing angles, in one band; azimuths of light are among the outgoing ones.
    """
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
    atomic.write_text(path, "\n".join([*lines, "End of file"]) + "\n")


def _head(kind: str, name: str) -> list[str]:
    """The first lines: version, text, comment, and the letters of a description that has none."""
    return [f"OPTIS - {kind} surface file v8.0", "0", in_one_line(name), "0", ""]


def _table_lines(theta: Array, phi: Array, f: Array) -> tuple[float, list[str]]:
    """The fraction of light that f (T, P) reflects, and the lines of its table, closed at the horizon and at 360."""
    f = np.maximum(np.hstack([f, f[:, :1]]), 0.0)
    phi = np.append(phi, phi[0] + 360.0)
    if theta[-1] < 90.0:
        theta, f = np.append(theta, 90.0), np.vstack([f, f[-1:]])
    rows = [f"{t:.6g}\t{_row(row)}" for t, row in zip(theta, f, strict=True)]
    return _reflected(theta, phi, f), [f"{theta.size} {phi.size}", "\t" + _row(phi), *rows]


def _row(values: Array) -> str:
    return "\t".join(f"{value:.7g}" for value in values)
