"""A library of a few RGB materials of the corpus, made once per test session, for tests that need one."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.records import BsdfFile
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.manifold import Manifold

NAMES = (
    "syn_felt_green", "syn_felt_orange", "syn_gloss_red", "syn_metal_copper", "syn_paper_white", "syn_satin_gold",
)  # fmt: skip

_MATERIALS = {m.name: m for m in corpus.isotropic_materials()}


@cache
def measured(name: str) -> BsdfFile:
    """A material of the corpus in RGB."""
    return corpus.measure(_MATERIALS[name], rgb=True)


def small_library(folder: Path, *, names: Sequence[str] = NAMES, library: Path | None = None) -> Path:
    """Write files into a folder and import them, by default into `library.zarr` there; the library's path."""
    files = folder / "files"
    files.mkdir(parents=True, exist_ok=True)
    for name in names:
        write_bsdf(files / f"{name}_rgb.bsdf", measured(name))
    path = folder / "library.zarr" if library is None else library
    result = import_files(path, [files])
    assert not result.failed
    return path


@cache
def _fitted() -> TemporaryDirectory[str]:
    """A folder with a small library and its model, until the session ends."""
    folder = TemporaryDirectory()
    path = Path(folder.name)
    model = Manifold.fit(Library.open(small_library(path)))
    model.save(path / "model.h5")
    return folder


def small_model(folder: Path) -> Path:
    """`model.h5` of a small library in a folder; the model's path."""
    fitted = Path(_fitted().name)
    shutil.copytree(fitted / "files", folder / "files")
    shutil.copytree(fitted / "library.zarr", folder / "library.zarr")
    Manifold.load(fitted / "model.h5", folder / "library.zarr").save(folder / "model.h5")
    return folder / "model.h5"


def spectral_materials() -> list[MeasuredBRDF]:
    """The materials of `spectral_files`."""
    return [MeasuredBRDF(file) for file in spectral_files().values()]


def spectral_files() -> dict[str, BsdfFile]:
    """The materials in 60 bands, linear between their blue, green and red."""
    x = np.linspace(0.0, 2.0, 60)
    low = np.minimum(x.astype(int), 1)
    t = (x - low)[None, None, :, None, None]
    nm = np.linspace(400, 700, 60, dtype=np.float32)
    files = {}
    for name in NAMES:
        file = measured(name)
        spectra = (1 - t) * file.spectra[:, :, low] + t * file.spectra[:, :, low + 1]
        files[name] = replace(file, wavelengths_nm=nm, spectra=spectra.astype(np.float32))
    return files
