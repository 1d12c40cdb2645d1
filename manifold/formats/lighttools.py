"""LightTools text `.bsdf`: blocks of `AOI`, `POI`, `Wavelength`, `TIS` and a table of azimuths x polar angles.

Angles are in degrees, measured from the normal. Synopsys' Mini-Diff also writes such files. Programs disagree on the
azimuth of the incident direction. A comment `# incidence at azimuth POI + 90`, which this module writes, determines it;
without one, it is found from the light's shadow or from the highlight.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.core import disk
from manifold.core.defaults import GONIOMETER, MINI_DIFF_SEES_DEG
from manifold.core.directions import from_spherical
from manifold.core.names import in_one_line
from manifold.core.records import Array
from manifold.formats.bsdf_text import (
    Block,
    BsdfText,
    angle_line,
    note_contradictions,
    read_blocks,
    total_scatter,
)
from manifold.formats.dense import DenseTable
from manifold.formats.light_side import hidden
from manifold.formats.readings import Assumption, Readings
from manifold.formats.text import decode
from manifold.formats.values import converted, linear_srgb_to_xyz, unnamed_band

_USUAL_AZIMUTH = (
    90.0  # azimuth of incidence relative to POI, where the data do not tell, and of what is written
)
_STATEMENT = re.compile(r"incidence (?:is )?at azimuth poi \+ (\d+(?:\.\d+)?)", re.IGNORECASE)
_AZIMUTHS = (90.0, 270.0, 180.0, 0.0)  # azimuths at which programs have the light
_NEAR = np.cos(np.deg2rad(10.0))  # cosine of the radius around a mirror direction
_AROUND = np.cos(np.deg2rad([20.0, 40.0]))
_TELLING = 1.6  # factor by which a highlight stands out; retro-reflection has at most 1.4


def sniff(head: bytes) -> bool:
    """Return whether a file's beginning has LightTools' keys: scatter angles, and the key AOI or no incidence yet."""
    text = decode(head).lower()
    if not re.search(r"^\s*scatter_?(azimuth|radial)", text, re.MULTILINE):
        return False
    # Mini-Diffs use Zemax' words as well; only they and LightTools write each incidence as AOI.
    is_zemax = re.search(r"^\s*(angleofincidence|samplerotation)", text, re.MULTILINE) is not None
    return not is_zemax or re.search(r"^\s*aoi\b", text, re.MULTILINE) is not None


def read(path: Path) -> list[Readings]:
    """Read the reflectance of the front side."""
    text = read_blocks(path)
    blocks = [block for block in text.blocks if _is_reflected(block)]
    if not blocks:
        raise text.context.error(
            "no block of front reflectance, expected AOI, POI, Wavelength, TIS and a table"
        )
    for block in blocks:
        text.require_brdf(block.words)
    notes: list[str] = []
    if left := len(text.blocks) - len(blocks):
        notes.append(f"{left} blocks of transmission or of the back are left out")
    cosine = np.cos(np.deg2rad(text.lists["scatterradial"]))
    note_contradictions(text, ((block, cosine) for block in blocks), notes)
    nm, incidences, values = _stack(blocks, notes, text)
    phi, theta, rows = text.directions()
    keep = np.abs(theta) <= 90.0
    values, theta, phi = values[:, rows][:, keep], theta[keep], phi[keep]
    heading = " ".join([*text.comments[:20], *blocks[0].words.values()])
    is_mini_diff = re.search(r"mini[\s_-]*diff", heading, re.IGNORECASE) is not None
    if is_mini_diff and _is_ramp(theta, phi, values):
        inside = theta <= MINI_DIFF_SEES_DEG + 1e-6
        notes.append(
            f"{int((~inside).sum())} directions beyond 75 degrees are padding of the Mini-Diff, not data"
        )
        values, theta, phi = values[:, inside], theta[inside], phi[inside]
    offset = _said_azimuth(text.comments, notes)
    if offset is None:
        offset = _incident_azimuth(incidences, theta, phi, values, notes)
    # Isotropic: incidence at azimuth 180, as elsewhere.
    is_isotropic = len({poi for _, poi in incidences}) == 1
    turn = 180.0 - incidences[0][1] - offset if is_isotropic else 0.0
    wo = from_spherical(np.deg2rad(theta), np.deg2rad(phi + turn))
    wo[:, 2] = np.maximum(wo[:, 2], 0.0)
    wi = np.repeat(
        [from_spherical(np.deg2rad(aoi), np.deg2rad(poi + offset + turn)) for aoi, poi in incidences],
        len(wo),
        axis=0,
    )
    wi[:, 2] = np.maximum(wi[:, 2], 0.0)
    values = values.reshape(-1, values.shape[-1])
    return [
        Readings(
            path.stem, "Mini-Diff (LightTools text)" if is_mini_diff else "LightTools BSDF",
            wi, np.tile(wo, (len(incidences), 1)), nm, values, notes=tuple(notes),
            repeatability=GONIOMETER,
        )
    ]  # fmt: skip


def _is_reflected(block: Block) -> bool:
    """Return whether a block holds reflection of light from the front."""
    side, kind = (block.words.get(key, "").lower() for key in ("side", "scattertype"))
    return (
        not side.startswith("back") and not kind.startswith("btdf") and block.numbers.get("aoi", 0.0) <= 90.0
    )


def _stack(
    blocks: list[Block], notes: list[str], text: BsdfText
) -> tuple[Array | None, list[tuple[float, float]], Array]:
    """Return wavelengths, or None for XYZ; incidences; values (incidences, azimuths * radials, B)."""
    context, is_xyz = text.context, any(b.tristimulus is not None for b in blocks)
    labels = [float(b.tristimulus or 0) if is_xyz else b.numbers.get("wavelength", 0.0) for b in blocks]
    angles = [(b.numbers.get("aoi", 0.0), b.numbers.get("poi", 0.0)) for b in blocks]
    bands, incidences = sorted(set(labels)), sorted(set(angles))
    if any(not 0.0 <= aoi <= 90.0 for aoi, _ in incidences):
        raise context.error(f"AOI {max(abs(a) for a, _ in incidences):g}, expected 0 to 90 degrees")
    if len(bands) * len(incidences) != len(blocks):
        raise context.error(
            f"found {len(blocks)} blocks, expected one for each of {len(bands)} bands at each of {len(incidences)} "
            "incidences; bands are named by Wavelength, or by TristimulusValue TrisX, TrisY and TrisZ"
        )
    values = np.full((len(incidences), blocks[0].values.size, len(bands)), np.nan)
    for block, label, incidence in zip(blocks, labels, angles, strict=True):
        values[incidences.index(incidence), :, bands.index(label)] = block.values.reshape(-1)
    if np.any(np.isnan(values)):
        raise context.error("found two blocks with the same incidence and band, expected one")
    if is_xyz:
        if len(bands) != 3:
            raise context.error(f"{len(bands)} tristimulus values, expected X, Y and Z")
        return None, incidences, converted(values, notes)
    if bands == [0.0]:
        return unnamed_band(notes, text.context, text.comments), incidences, values
    return np.array(bands), incidences, values


def _is_ramp(theta: Array, phi: Array, values: Array) -> bool:
    """Return whether values fall linearly to zero from 75 to 90 degrees."""
    beyond = (theta >= MINI_DIFF_SEES_DEG) & (phi == phi[-1])
    at, ramp = theta[beyond], values[:, beyond]
    if at.size < 4 or not np.isclose(at[-1], 90.0) or at[0] > MINI_DIFF_SEES_DEG + 1.0:
        return False
    line = ramp[:, :1] * ((90.0 - at) / (90.0 - at[0]))[:, None]
    return bool(np.allclose(ramp, line, rtol=0.02, atol=0.02 * float(np.abs(ramp).max() + 1e-300)))


def _said_azimuth(comments: list[str], notes: list[str]) -> float | None:
    """Return the azimuth of incidence relative to POI in degrees that a comment states, or None."""
    said = next((match for line in comments if (match := _STATEMENT.search(line)) is not None), None)
    if said is None:
        return None
    notes.append(f"incidence is taken at azimuth POI + {float(said[1]):g}, as a comment in the file states")
    return float(said[1])


def _incident_azimuth(
    incidences: list[tuple[float, float]], theta: Array, phi: Array, values: Array, notes: list[str]
) -> float:
    """Return one of four azimuths of incidence relative to POI in degrees.

    It is the one that the receiver hides, or the one opposite the highlight.

    A material without a highlight, such as a matt one, does not decide between them.
    """
    oblique = [k for k, (aoi, _) in enumerate(incidences) if 10.0 <= aoi <= 70.0]
    if not oblique:
        return _USUAL_AZIMUTH
    wo = from_spherical(np.deg2rad(theta), np.deg2rad(phi))
    shadowed = [o for o in _AZIMUTHS if _is_hidden(incidences, oblique, wo, values, o)]
    if len(shadowed) == 1:
        notes.append(
            f"incidence is taken at azimuth POI + {shadowed[0]:g}, where the receiver hides the light"
        )
        return shadowed[0]
    peaks = {o: _peak(incidences, oblique, wo, values.mean(axis=-1), o) for o in _AZIMUTHS}
    best = max(peaks, key=lambda offset: peaks[offset])
    if peaks[best] >= _TELLING * max(peak for offset, peak in peaks.items() if offset != best):
        notes.append(f"incidence is taken at azimuth POI + {best:g}, opposite the highlight")
        return best
    in_usual_plane = peaks[90.0] + peaks[270.0] >= peaks[0.0] + peaks[180.0]
    taken = _USUAL_AZIMUTH if in_usual_plane else _USUAL_AZIMUTH + 90.0
    unknown = "no highlight shows the mirror direction"
    notes.append(Assumption(f"{unknown}: incidence is taken at azimuth POI + {taken:g}"))
    return taken


def _is_hidden(
    incidences: list[tuple[float, float]], oblique: list[int], wo: Array, values: Array, offset: float
) -> bool:
    """Return whether the receiver hides the light, which lies at POI + offset, at most incidences."""
    count = 0
    for k in oblique:
        aoi, poi = incidences[k]
        wi = from_spherical(np.deg2rad(aoi), np.deg2rad(poi + offset))
        count += bool(np.any(hidden(np.broadcast_to(wi, wo.shape), wo, values[k])))
    return 2 * count > len(oblique)


def _peak(
    incidences: list[tuple[float, float]], oblique: list[int], wo: Array, brightness: Array, offset: float
) -> float:
    """Return how much brighter the mirror direction is than its surroundings, for incidence at POI + offset."""
    total = 0.0
    for k in oblique:
        aoi, poi = incidences[k]
        cosine = wo @ from_spherical(np.deg2rad(aoi), np.deg2rad(poi + offset + 180.0))
        near, around = cosine > _NEAR, (cosine < _AROUND[0]) & (cosine > _AROUND[1])
        if np.any(near) and np.any(around):
            total += float(brightness[k, near].mean() / max(brightness[k, around].mean(), 1e-300))
    return total


def write(path: Path, table: DenseTable) -> None:
    """Write blocks of every incidence and wavelength; linear sRGB becomes CIE XYZ.

    The light is at azimuth POI + 90. An isotropic table has POI 0, and its azimuths are turned accordingly;
    anisotropic tables keep the azimuths of the sample.
    """
    theta_i, phi_i, theta_o, phi_o = (np.rad2deg(a) for a in table.axes)
    values = np.nan_to_num(table.values)
    if table.bands.is_rgb:
        values = linear_srgb_to_xyz(values)
    turn = 0
    poi = np.mod(phi_i - _USUAL_AZIMUTH, 360.0)
    if phi_i.size == 1:
        poi, turn = np.zeros(1), -int(np.argmin(np.abs(phi_o - (phi_i[0] - _USUAL_AZIMUTH))))
    closed = np.append(phi_o, phi_o[0] + 360.0)
    lines = [
        "#LightTools BSDF", f"#incidence at azimuth POI + {_USUAL_AZIMUTH:g}", f"#{in_one_line(table.name)}",
        "Symmetry Asymmetric",
        f"SpectralContent {'XYZ' if table.bands.is_rgb else 'Monochrome'}", f"ScatterAzimuth {closed.size}",
        angle_line(closed), f"ScatterRadial {theta_o.size}", angle_line(theta_o), "DataBegin",
    ]  # fmt: skip
    nm = table.bands.wavelengths_nm
    for i, aoi in enumerate(theta_i):
        for j in np.argsort(poi):
            for b in range(values.shape[-1]):
                kind = f"Wavelength {nm[b]:g}" if nm is not None else f"TristimulusValue Tris{'XYZ'[b]}"
                lines += [f"AOI {aoi:.6g}", f"POI {poi[j]:.6g}", "Side Front", kind, "ScatterType BRDF"]
                rows = np.roll(values[i, j, :, :, b].T, turn, axis=0)
                rows = np.vstack([rows, rows[:1]])
                tis = total_scatter(rows, np.deg2rad(closed), table.axes[2], np.cos(table.axes[2]))
                lines += [f"TIS {tis:.6g}", *(" ".join(f"{v:.7g}" for v in row) for row in rows)]
    disk.write_text(path, "\n".join([*lines, "DataEnd"]) + "\n")
