"""What the steps start from: files and libraries in one folder, which steps read and do not change."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import tifffile
from helpers.instrument_files import SUFFIXES, write_every_format
from helpers.paths import REPOSITORY, real_rgl_folder

import manifold as mf
from golden.commands import command

SHARED = REPOSITORY.parent / "shared" / "files"

_REAL = (
    "acrylic_felt_green", "aurora_white", "cardboard", "cc_ibiza_sunset", "chm_mint", "ilm_l3_37_matte",
    "satin_purple", "vch_golden_yellow",
)  # fmt: skip
_REAL_LEFT_OUT = ("paper_blue", "cm_toxic_green")
_CORPUS = (
    "syn_felt_green", "syn_felt_orange", "syn_gloss_red", "syn_metal_copper", "syn_paper_white", "syn_satin_gold",
    "syn_metallic_red", "syn_paint_sand",
)  # fmt: skip
_CORPUS_LEFT_OUT = ("syn_satin_rose", "syn_felt_yellow")
_SPECTRAL = ("syn_felt_green", "syn_gloss_red", "syn_metal_copper", "syn_paper_white", "syn_satin_gold")
_LAMP = np.array([0.0, 0.6, 0.8])  # right, up, towards the camera


def prepare(folder: Path) -> None:
    """Write all inputs; those of real files only where the files are at hand."""
    os.chdir(folder)
    _corpus(folder)
    _readings(folder)
    _spectral(folder)
    _photograph(folder)
    for name in ("corpus", "spectral"):
        _embed(name)
    real = real_rgl_folder()
    if real is not None:
        for names, where in ((_REAL, folder / "real"), (_REAL_LEFT_OUT, folder / "real-left-out")):
            where.mkdir()
            for name in names:
                shutil.copy(real / f"{name}_rgb.bsdf", where)
        _embed("real")
    if SHARED.is_dir():
        (folder / "shared").symlink_to(SHARED)
        _real_photograph(folder)


def _embed(name: str) -> None:
    command(f"import {name} -L {name}.zarr")
    command(f"embed -L {name}.zarr -M {name}.h5")


def _corpus(folder: Path) -> None:
    materials = {m.name: m for m in mf.analytic.corpus.isotropic_materials()}
    for names, where in ((_CORPUS, folder / "corpus"), (_CORPUS_LEFT_OUT, folder / "corpus-left-out")):
        where.mkdir()
        for name in names:
            mf.write_bsdf(where / f"{name}_rgb.bsdf", mf.analytic.corpus.measure(materials[name], rgb=True))


def _spectral(folder: Path) -> None:
    materials = {m.name: m for m in mf.analytic.corpus.isotropic_materials()}
    for names, where in ((_SPECTRAL, "spectral"), (_CORPUS_LEFT_OUT[:1], "spectral-left-out")):
        (folder / where).mkdir()
        for name in names:
            file = mf.analytic.corpus.measure(materials[name])
            mf.write_bsdf(folder / where / f"{name}_spec.bsdf", file)


def _readings(folder: Path) -> None:
    """A file of every format, the corpus as two instruments read it, and tables by hand."""
    (folder / "formats").mkdir()
    for name, path in write_every_format(folder / "formats").items():
        (folder / "formats" / name).mkdir()
        path.rename(folder / "formats" / name / f"smooth{SUFFIXES[name][SUFFIXES[name].rfind('.') :]}")
    command("corpus ma-t12 --instrument ma-t12")
    command("corpus mini-diff --instrument mini-diff")
    for instrument, suffix in (("ma-t12", ".xlsx"), ("mini-diff", ".astm")):
        (folder / f"{instrument}-few").mkdir()
        for name in _CORPUS:
            shutil.copy(folder / instrument / f"{name}{suffix}", folder / f"{instrument}-few")
    nm = np.arange(400, 701, 20)
    reflectance = 0.1 + 0.6 / (1.0 + np.exp((560.0 - nm) / 15.0))
    lines = ["Name,Geometry," + ",".join(map(str, nm))]
    lines.append("sand,45/0," + ",".join(f"{r:.5f}" for r in reflectance))
    (folder / "sand.csv").write_text("\n".join(lines) + "\n")
    (folder / "reflectance.txt").write_text(
        "".join(f"{n} {r:.5f}\n" for n, r in zip(nm, reflectance, strict=True))
    )
    (folder / "places.csv").write_text(
        "x,y,name,srgb\n0.3,0.5,one,\n-0.4,0.2,two,#a04020\n0.1,-0.6,three,\n", encoding="utf-8"
    )
    parameters = [
        {"name": "reflectance", "minimum": 0.0, "maximum": 1.0, "default": 0.5, "per_band": True},
    ]
    document = {"type": "diffuse", "parameters": parameters, "fixed": {}}
    (folder / "diffuse.json").write_text(json.dumps(document))


def _photograph(folder: Path) -> None:
    """A ball of a material seen from far, in the light of one lamp and its surroundings, by direct summation."""
    rows, columns, size = 32, 64, 48
    theta, phi = (np.arange(rows) + 0.5) * np.pi / rows, (np.arange(columns) + 0.5) * 2 * np.pi / columns
    t, p = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    # The first column is straight ahead of the camera, behind the ball; the lamp is symmetric left and right.
    towards = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], axis=1)
    radiance = 0.2 + 30.0 * (towards @ _LAMP > np.cos(0.12))[:, None] * np.array([1.0, 0.9, 0.8])
    light = radiance.reshape(rows, columns, 3)
    weight = radiance * (np.sin(t) * (np.pi / rows) * (2 * np.pi / columns))[:, None]
    brdf = mf.MeasuredBRDF(mf.read_bsdf(folder / "corpus-left-out" / "syn_satin_rose_rgb.bsdf"))
    picture = np.zeros((size, size, 3))
    radius = size / 2.6
    for y in range(size):
        for x in range(size):
            right, up = (x + 0.5 - size / 2) / radius, (size / 2 - y - 0.5) / radius
            if right * right + up * up < 1.0:
                normal = np.array([right, up, np.sqrt(1.0 - right * right - up * up)])
                picture[y, x] = _seen(brdf, normal, towards, weight)
    _write_exr(folder / "light.exr", light)
    tifffile.imwrite(folder / "ball.tif", picture.astype(np.float32))


def _seen(brdf: mf.MeasuredBRDF, normal: np.ndarray, towards: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Radiance (3,) of a point of the ball to the camera, which is at +z."""
    across = np.cross(normal, [0.0, 0.0, 1.0] if normal[2] < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(normal, across), normal])
    wo = towards @ frame.T
    lit = wo[:, 2] > 0
    wi = np.broadcast_to(frame[:, 2], wo.shape)
    return np.sum(brdf.eval(wi[lit], wo[lit]) * wo[lit, 2:] * weight[lit], axis=0)


def _real_photograph(folder: Path) -> None:
    """The lamp of the first photograph of the grey ball, as a picture of the light."""
    photographs = folder / "shared" / "ball-photographs"
    if not photographs.is_dir():
        return
    right, up, towards_camera = np.loadtxt(photographs / "lights.txt", skiprows=1)[0]
    rows, columns = 64, 128
    t = (np.arange(rows)[:, None] + 0.5) * np.pi / rows
    p = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    towards = np.stack([np.sin(t) * np.sin(p), np.cos(t) + 0.0 * p, -np.sin(t) * np.cos(p)], axis=-1)
    lamp = towards @ [right, up, towards_camera] > np.cos(0.06)
    _write_exr(folder / "lamp.exr", np.repeat(300.0 * lamp[..., None], 3, axis=2))


def _write_exr(path: Path, pixels: np.ndarray) -> None:
    import mitsuba

    if mitsuba.variant() is None:
        mitsuba.set_variant("scalar_rgb")
    mitsuba.Bitmap(pixels.astype(np.float32)).write(str(path))
