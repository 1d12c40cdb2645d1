"""Simulates readings of a BRDF, with noise, and writes them as files of an MA-T12 or a Mini-Diff V2.

The files have the layout and quirks of real files: see `manifold.formats.ma_t12` and
`manifold.formats.astm`.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from manifold.analytic.corpus import Material, isotropic_materials, write_files
from manifold.brdf.interface import BRDF
from manifold.core import disk
from manifold.core.defaults import MINI_DIFF_SEES_DEG
from manifold.core.directions import from_spherical
from manifold.core.records import Array, Bands
from manifold.formats import ma_t12
from manifold.formats.readings import MA_T12_NAMES, Readings, geometry_ma_t12
from manifold.registries import INSTRUMENTS

MA_T12_BANDS = Bands(tuple(float(nm) for nm in range(400, 701, 10)))
MINI_DIFF_BANDS = Bands((465.0, 525.0, 630.0))
MINI_DIFF_INCIDENCES_DEG = (0.0, 20.0, 40.0, 60.0)
_FLAKY = ("metallic", "flake", "iridescent")


def ma_t12_readings(brdf: BRDF, name: str, rng: np.random.Generator | None = None) -> Readings:
    """Return readings of a BRDF, in `MA_T12_BANDS` or RGB, at the 12 geometries of an MA-T12.

    `rng` adds noise with a standard deviation of 0.3 % of the value, and of 3e-4 in reflectance factor.
    """
    wi, wo = geometry_ma_t12()
    R = np.pi * np.asarray(brdf.eval(wi, wo), dtype=float)
    if rng is not None:
        # Gain is common to the bands of a geometry: the sample is put down anew for no band.
        gain = 1.0 + 0.002 * rng.standard_normal((len(wi), 1))
        R = np.maximum(R * gain * (1.0 + 0.003 * rng.standard_normal(R.shape)), 0.0)
        R = np.maximum(R + 3e-4 * rng.standard_normal(R.shape), 0.0)
    nm = brdf.bands.wavelengths_nm
    return Readings(name, "X-Rite MA-T12", wi, wo, None if nm is None else np.array(nm), R / np.pi)


def mini_diff_table(brdf: BRDF, rng: np.random.Generator | None) -> tuple[Array, Array]:
    """Return the whole table of a Mini-Diff V2, with padding: angles in radians (P, 4) and f in 1/sr (P, B).

    The angles are theta_i, phi_i, theta_s, phi_s. `rng` adds noise with a standard deviation of 1 % of the value, and
    of 2e-4 in 1/sr, so that dark values may be negative.
    """
    phi, theta = np.meshgrid(np.arange(0.0, 360.0, 10.0), np.arange(1.0, 91.0), indexing="ij")
    phi_s = np.deg2rad(np.concatenate([[0.0], phi.reshape(-1)]))
    theta_s = np.deg2rad(np.concatenate([[0.0], theta.reshape(-1)]))
    angles, values = [], []
    for incidence in np.deg2rad(MINI_DIFF_INCIDENCES_DEG):
        wi = from_spherical(incidence, np.pi)
        edge = np.deg2rad(MINI_DIFF_SEES_DEG)
        f = np.asarray(brdf.eval(wi, from_spherical(np.minimum(theta_s, edge), phi_s)), dtype=float)
        if rng is not None:
            f = f * (1.0 + 0.01 * rng.standard_normal(f.shape)) + 2e-4 * rng.standard_normal(f.shape)
        ramp = np.clip((0.5 * np.pi - theta_s) / (0.5 * np.pi - edge), 0.0, 1.0)
        at_edge = np.isclose(theta_s, edge)
        per_azimuth = {round(float(p), 9): row for p, row in zip(phi_s[at_edge], f[at_edge], strict=True)}
        beyond = theta_s > edge + 1e-9
        f[beyond] = np.array([per_azimuth[round(float(p), 9)] for p in phi_s[beyond]]) * ramp[beyond, None]
        angles.append(
            np.stack([np.full_like(theta_s, incidence), np.full_like(theta_s, np.pi), theta_s, phi_s], 1)
        )
        values.append(f)
    return np.concatenate(angles), np.concatenate(values)


def write_mini_diff(path: Path, brdf: BRDF, name: str, rng: np.random.Generator | None = None) -> None:
    """Write an ASTM file like a Mini-Diff V2: `VARS` names no phi_s, and values beyond 75 degrees form a ramp."""
    angles, values = mini_diff_table(brdf, rng)
    heads = ",".join(f"{nm:g}nm" for nm in brdf.bands.wavelengths_nm or ())
    lines = [
        'LAB_NAME "Virtual"', 'SYSTEM_NAME "Mini-Diff V2"', f'SAMPLE_NAME "{name}"', 'MEAS_NAME "BRDF"',
        f"NUM_POINTS {len(values)}", f"VARS theta_i,phi_i,theta_s,{heads}",
    ]  # fmt: skip
    rows = np.hstack([angles, values])
    lines += [
        ",".join(f"{v:.6f}" for v in row[:4]) + "," + ",".join(f"{v:.6e}" for v in row[4:]) for row in rows
    ]
    disk.write_text(path, "\r\n".join(lines) + "\r\n")


def write_ma_t12(
    path: Path, brdf: BRDF, name: str, rng: np.random.Generator, *, flakes: bool = False
) -> None:
    """Write a workbook like the MA-T12's program, including texture."""
    entries = [
        {
            "Name": name,
            "Geometry": geometry,
            "Coarseness": round(float(rng.uniform(2.0, 9.0) if flakes else rng.uniform(0.0, 0.6)), 3),
            "Sparkle Grade": round(float(rng.uniform(1.0, 6.0) if flakes else 0.0), 3),
        }
        for geometry in MA_T12_NAMES[6:]
    ]
    readings = ma_t12_readings(brdf, name, rng)
    images = {geometry: _flake_image(rng, flakes) for geometry in MA_T12_NAMES[6:]}
    ma_t12.write(path, replace(readings, texture={"values": entries, "images": images}))


def _flake_image(rng: np.random.Generator, flakes: bool) -> bytes:
    """Return a PNG picture of a grey surface, with or without bright flakes."""
    from PIL import Image

    grey = 90.0 + 4.0 * rng.standard_normal((64, 64))
    if flakes:
        grey += 150.0 * (rng.random((64, 64)) < 0.02)
    out = io.BytesIO()
    Image.fromarray(np.clip(grey, 0.0, 255.0).astype(np.uint8)).save(out, "PNG")
    return out.getvalue()


MA_T12, MINI_DIFF = (MA_T12_BANDS, ".xlsx"), (MINI_DIFF_BANDS, ".astm")
"""Bands and file suffixes of the instruments in `INSTRUMENTS`."""


def write(
    folder: Path | str,
    instrument: str,
    *,
    seed: int = 0,
    materials: Callable[[], tuple[Material, ...]] = isotropic_materials,
) -> list[Path]:
    """Write simulated readings of every isotropic material: `ma-t12` workbooks or `mini-diff` ASTM tables.

    Each material has one file in the folder, which is created if missing.
    """
    bands, suffix = INSTRUMENTS[instrument]

    def write_one(path: Path, material: Material) -> None:
        rng = np.random.default_rng([seed, *instrument.encode(), *material.name.encode()])
        brdf = material.truth(bands)
        if instrument == "ma-t12":
            write_ma_t12(path, brdf, material.name, rng, flakes=material.family in _FLAKY)
        else:
            write_mini_diff(path, brdf, material.name, rng)

    writers = {material.name: partial(write_one, material=material) for material in materials()}
    return write_files(folder, suffix, writers)
