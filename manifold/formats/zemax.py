"""Zemax text `.bsdf`: sample rotations, incidences, then tables of azimuths x radial angles from the mirror direction.

Azimuth 0 points from the mirror direction towards the normal. `Monochrome`, or `XYZ` in three parts.

Source: Zemax, "BSDF data interchange file format specification".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from manifold.core import disk
from manifold.core.defaults import GONIOMETER, MINI_DIFF_SEES_DEG
from manifold.core.directions import from_spherical, rotate_z
from manifold.core.names import in_one_line
from manifold.core.records import Array, Mask
from manifold.formats.bsdf_text import (
    Block,
    BsdfText,
    angle_line,
    note_contradictions,
    read_blocks,
    total_scatter,
)
from manifold.formats.readings import Readings
from manifold.formats.text import decode
from manifold.formats.values import converted, linear_srgb_to_xyz, unnamed_band


def sniff(head: bytes) -> bool:
    """Return whether the beginning of a file contains the lists of angles of a Zemax file."""
    text = decode(head).lower()
    return re.search(r"^\s*(angleofincidence|samplerotation)\b", text, re.MULTILINE) is not None


def directions(theta_i: float, radial: Array, azimuth: Array, rotation: float = 0.0) -> tuple[Array, Array]:
    """Return wi (3,) and wo (..., 3) from an incidence and angles from its mirror direction, in radians.

    wi lies at azimuth 180 degrees plus the sample's rotation.
    """
    x, y, z = np.moveaxis(from_spherical(radial, azimuth), -1, 0)
    c, s = np.cos(theta_i), np.sin(theta_i)
    # About the y axis: radial 0 becomes the mirror direction, azimuth 0 points from there to the normal.
    turned = np.stack([-x * c + z * s, -y, x * s + z * c], axis=-1)
    return from_spherical(theta_i, np.pi + rotation), rotate_z(turned, rotation)


def read(path: Path) -> list[Readings]:
    """Read the reflected directions above the horizon."""
    text = read_blocks(path)
    said = text.blocks[0].words if text.blocks else {}
    text.require_brdf(said)
    parts: dict[int | None, list[Block]] = {}
    for block in text.blocks:
        parts.setdefault(block.tristimulus, []).append(block)
    rotations = text.lists.get("samplerotation", np.zeros(1))
    incidences = [(r, t) for r in rotations for t in text.lists.get("angleofincidence", [])]
    counts = {len(part) for part in parts.values()}
    if counts != {len(incidences)} or set(parts) not in ({None}, {0, 1, 2}):
        found = ", ".join(str(count) for count in sorted(counts)) or "no"
        why = "the file is cut off"
        if max(counts, default=0) > len(incidences):
            why = f"SpectralContent {said.get('spectralcontent', 'not stated')}, expected Monochrome or XYZ"
        raise text.context.error(f"{found} tables, expected {len(incidences)}, one per incidence: {why}")
    notes = ["angles are taken about the mirror direction, azimuth 0 towards the normal"]
    nm = unnamed_band(notes, text.context, text.comments) if None in parts else None
    radial, azimuth = (np.deg2rad(text.lists[f"scatter{name}"]) for name in ("radial", "azimuth"))
    cosines = [directions(np.deg2rad(t), radial, azimuth[:, None])[1][..., 2] for _, t in incidences]
    note_contradictions(
        text, (pair for part in parts.values() for pair in zip(part, cosines, strict=True)), notes
    )
    values = np.stack(
        [np.array([block.values for block in parts[band]]) for band in sorted(parts, key=lambda k: k or 0)],
        axis=-1,
    )
    return [_readings(path.stem, incidences, text, values, nm, notes)]


def _is_measured(wo: Array, values: Array) -> Mask:
    """Return a mask of the directions (n, 3) of one incidence with data, (n,); zeros that fill the table have none."""
    is_dark = np.all(values == 0.0, axis=1)
    # Instruments end at 75 to 85 degrees, tables at the horizon.
    lowest = np.min(wo[~is_dark, 2], initial=np.cos(np.deg2rad(MINI_DIFF_SEES_DEG)))
    is_data: Mask = ~is_dark | (wo[:, 2] > lowest - 1e-6) | bool(np.all(is_dark))
    return is_data


def _readings(
    name: str,
    incidences: list[tuple[float, float]],
    text: BsdfText,
    values: Array,
    nm: Array | None,
    notes: list[str],
) -> Readings:
    azimuth, radial, rows = text.directions()
    azimuth, radial = np.deg2rad(azimuth), np.deg2rad(radial)
    values = values.reshape(len(values), -1, values.shape[-1])[:, rows]
    wi, wo, kept, padding = [], [], [], 0
    for (rotation, theta), block in zip(incidences, values, strict=True):
        w, out = directions(np.deg2rad(theta), radial, azimuth, np.deg2rad(rotation))
        above = out[:, 2] > 1e-6
        is_data = _is_measured(out[above], block[above])
        padding += int((~is_data).sum())
        above[above] = is_data
        wi.append(np.tile(np.maximum(w, [-1.0, -1.0, 0.0]), (int(above.sum()), 1)))
        wo.append(out[above])
        kept.append(block[above])
    if padding:
        notes.append(f"{padding} zeros near the horizon, beyond the last measured direction, are not data")
    table = np.concatenate(kept)
    if nm is None:
        table = converted(table, notes)
    return Readings(
        name, "Zemax BSDF", np.concatenate(wi), np.concatenate(wo), nm, table, notes=tuple(notes),
        repeatability=GONIOMETER,
    )  # fmt: skip


def write(
    path: Path,
    name: str,
    theta_i: Array,
    azimuth: Array,
    radial: Array,
    values: Array,
    rotation: Array | None = None,
) -> None:
    """Write tables of values in 1/sr, shape (S, T, A, R, B) for S sample rotations, or (T, A, R, B); angles in radians.

    B = 3 is linear sRGB, which is converted to CIE XYZ; B = 1 is monochrome. See `directions` for the sense of
    rotation.
    """
    turns = np.zeros(1) if rotation is None else rotation
    values = np.nan_to_num(values).reshape(turns.size, *values.shape[-4:])
    if values.shape[-1] == 3:
        values = linear_srgb_to_xyz(values)
    lines = [
        f"# {in_one_line(name)}", "Source Measured", "Symmetry Asymmetrical",
        f"SpectralContent {'XYZ' if values.shape[-1] == 3 else 'Monochrome'}", "ScatterType BRDF",
        f"SampleRotation {turns.size}", angle_line(np.rad2deg(turns)), f"AngleOfIncidence {theta_i.size}",
        angle_line(np.rad2deg(theta_i)), f"ScatterAzimuth {azimuth.size}", angle_line(np.rad2deg(azimuth)),
        f"ScatterRadial {radial.size}", angle_line(np.rad2deg(radial)), "",
    ]  # fmt: skip
    for b in range(values.shape[-1]):
        lines += ["Monochrome" if values.shape[-1] == 1 else f"Tristimulus{'XYZ'[b]}", "DataBegin"]
        for turned in values[..., b]:
            for theta, block in zip(theta_i, turned, strict=True):
                _, wo = directions(theta, radial[None, :], azimuth[:, None])
                lines.append(f"TIS {total_scatter(block, azimuth, radial, wo[..., 2]):.6g}")
                lines += [" ".join(f"{v:.7g}" for v in row) for row in block]
        lines.append("DataEnd")
    disk.write_text(path, "\n".join(lines) + "\n")
