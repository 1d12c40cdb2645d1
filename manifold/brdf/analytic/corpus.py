"""The built-in corpus: synthetic materials in the families of the real database, measured by the virtual goniometer.

51 isotropic materials, and on request 11 anisotropic ones, on the wavelength grid of the RGL database, with its
resolutions, its 8 incident elevations that differ from file to file, and noise, unmeasured cells and exact
zeros like those of its files. Everything follows from one seed. Files are marked as synthetic: names begin with
`syn_`, descriptions with "Synthetic".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.analytic.recipes import anisotropic_recipes, isotropic_recipes
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.unmeasured import find_rim
from manifold.colour.conversion import file_to_srgb, luminance
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.io_rgl import rgl_wavelengths_nm, write_bsdf
from manifold.records import Array, Bands, BsdfFile, Indices
from manifold.system import progress

_PIPELINE_VERSIONS = ((2, 0), (3, 0), (3, 1), (3, 2), (3, 3))
# Noise from cell to cell, as a share of the value: 0.2 to 0.7 % in most real files, 1 % in coats, 2 to 4 % where
# flakes sparkle.
_SPECKLE = {"metallic": 0.008, "chrome": 0.008, "iridescent": 0.02, "flake": 0.03}
_LEAST_SPECKLE = 0.003
_DRIFT = 0.005  # of the lamp, from one incidence to the next
_MAX_ALBEDO = 0.99  # of a file at the incidences between its last nodes, before noise
_STEEPEST = np.deg2rad(87.0)
# As in the real database, where two files are finer than the others.
_RESOLUTIONS = {"syn_gloss_yellow": 64, "syn_flake_blue_fine": 48}


@dataclass(frozen=True)
class Material:
    """One material of the corpus.

    Attributes:
        name: `syn_` and the family first.
        family: felt, paper, paint, card, leaf, standard, satin, gloss, metallic, chrome, flake, iridescent, metal,
            or for anisotropic ones brushed, foil, weave.
        recipe: makes the analytic BRDF for given bands.
        resolution: nodes per axis of the outgoing grid.
    """

    name: str
    family: str
    recipe: Callable[[Bands], BRDF]
    resolution: int = 32

    @property
    def description(self) -> str:
        """The description in the file."""
        return f"Synthetic {self.family}: {self.name.removeprefix('syn_').replace('_', ' ')}"

    def truth(self, bands: Bands | None = None) -> BRDF:
        """The analytic BRDF behind the file, by default in the 195 bands of the RGL database.

        Args:
            bands: any wavelengths; not RGB.
        """
        return self.recipe(rgl_bands() if bands is None else bands)


def rgl_bands() -> Bands:
    """The 195 bands of the RGL database, 358.63 to 1001.89 nm."""
    return Bands.from_array(rgl_wavelengths_nm())


def isotropic_materials() -> tuple[Material, ...]:
    """The 51 isotropic materials, in a fixed order."""
    return _materials(isotropic_recipes())


def anisotropic_materials() -> tuple[Material, ...]:
    """The 11 anisotropic materials, in a fixed order."""
    return _materials(anisotropic_recipes())


def _materials(recipes: dict[str, Callable[[Bands], BRDF]]) -> tuple[Material, ...]:
    return tuple(
        Material(f"syn_{name}", name.split("_")[0], recipe, _RESOLUTIONS.get(f"syn_{name}", 32))
        for name, recipe in recipes.items()
    )


def measure(material: Material, *, seed: int = 0, rgb: bool = False) -> BsdfFile:
    """Measure a material as the instrument would, noise and unmeasured cells included.

    Args:
        material: one of this corpus.
        seed: of everything random; the same seed gives the same bytes.
        rgb: give linear sRGB under D65 instead of 195 bands, as the database's RGB files do.
    """
    rng = np.random.default_rng([seed, *material.name.encode()])
    version = _PIPELINE_VERSIONS[int(rng.integers(len(_PIPELINE_VERSIONS)))]
    file = goniometer.measure(
        material.truth(),
        material.name,
        description=material.description,
        resolution=material.resolution,
        theta_i_rad=_theta_i(rng),
        warp_exponent=1.0,
        version=version,
    )
    file = _imperfect(_energy_conserving(file), rng, _SPECKLE.get(material.family, _LEAST_SPECKLE))
    # As the database derives its RGB files, which say version 1.0.
    return replace(file_to_srgb(file), version=(1, 0)) if rgb else file


def write(
    folder: Path | str,
    *,
    seed: int = 0,
    anisotropic: bool = False,
    rgb: bool = False,
    keep: bool = False,
) -> list[Path]:
    """Write the corpus as `NAME_spec.bsdf` (or `NAME_rgb.bsdf`) files.

    Args:
        folder: made if missing.
        seed, rgb: as in `measure`.
        anisotropic: add the 11 anisotropic materials, 110 MB each.
        keep: leave existing files as they are; files are complete under their final names.
    Returns:
        The paths, in the order of the corpus.
    Raises:
        UsageError: the folder cannot be made.
    """
    materials = isotropic_materials() + (anisotropic_materials() if anisotropic else ())
    writers = {m.name: lambda path, m=m: write_bsdf(path, measure(m, seed=seed, rgb=rgb)) for m in materials}
    return write_files(folder, "_rgb.bsdf" if rgb else "_spec.bsdf", writers, keep=keep)


def write_files(
    folder: Path | str,
    ending: str,
    writers: Mapping[str, Callable[[Path], None]],
    *,
    keep: bool = False,
) -> list[Path]:
    """Write a file for every name and what writes it, the ending behind the name; else as `write`."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot make this folder ({error.strerror}); name another one") from error
    paths = {name: folder / f"{name}{ending}" for name in writers}
    for name in progress.each(writers, str):
        if not (keep and paths[name].exists()):
            writers[name](paths[name])
    return list(paths.values())


def _theta_i(rng: np.random.Generator) -> Array:
    """Eight elevations near the default ones, each moved by up to a degree and a half."""
    theta = goniometer.default_theta_i(8)
    theta[1:-1] += np.deg2rad(rng.uniform(-1.5, 1.5, 6))
    return theta


def _energy_conserving(file: BsdfFile) -> BsdfFile:
    """Darken grazing incidences at which the file, interpolated, would reflect more light than arrives.

    A gloss that grows towards grazing on a bright base is narrower than the cells there.
    """
    nodes = file.theta_i_rad.astype(float)
    for _ in range(4):
        between = np.minimum(nodes[-2:] - 0.5 * np.diff(nodes)[-2:], _STEEPEST)
        inside = np.append(between, min(nodes[-1], _STEEPEST))
        albedo = MeasuredBRDF(file).albedo(from_spherical(inside, 0.0)).max(axis=-1)
        if albedo.max() <= _MAX_ALBEDO:
            break
        spectra = file.spectra.copy()
        spectra[:, -1] *= np.minimum(_MAX_ALBEDO / albedo[1:].max(), 1.0)
        spectra[:, -2] *= np.minimum(_MAX_ALBEDO / albedo[0], 1.0)
        file = replace(file, spectra=spectra)
    return file


def _imperfect(file: BsdfFile, rng: np.random.Generator, speckle: float) -> BsdfFile:
    """Add what an instrument adds: noise, cells it did not reach, and signals clamped at zero."""
    measured = file.measured_mask  # (P, T, H, W)
    # Cells next to the horizon are extrapolated in the real files: filled, but some not marked as measured.
    rim = measured & find_rim(file) & (rng.random(measured.shape) < 0.9)
    # A few cells are unmeasured: no value in any band.
    lost = measured & (rng.random(measured.shape) < rng.uniform(0.0, 0.004))
    values = np.moveaxis(file.spectra, 2, -1).copy()  # (P, T, H, W, B)
    values[measured] = _noisy(values[measured], np.nonzero(measured)[1], rng, speckle)
    values[lost] = 0.0
    relative_luminance = np.maximum(luminance(values, file.bands), 0.0).astype(np.float32)
    return replace(
        file,
        spectra=np.moveaxis(values, -1, 2),
        luminance=relative_luminance,
        valid=goniometer.pack_valid(measured & ~rim & ~lost, file.version),
    )


def _noisy(values: Array, incidence: Indices, rng: np.random.Generator, speckle: float) -> Array:
    """Values (n, B) of cells as an instrument reads them, of the elevations with indices (n,)."""
    n, n_bands = values.shape
    # Speckle is common to all bands of a cell; the detector's noise is not, and is worse towards both ends.
    cells = 1.0 + speckle * rng.standard_normal(n, dtype=np.float32)
    cells *= 1.0 + _DRIFT * rng.standard_normal(incidence.max() + 1, dtype=np.float32)[incidence]
    band = np.linspace(-1.0, 1.0, n_bands, dtype=np.float32)
    dark = 2e-4 * np.median(values[::8]) * (1.0 + 20.0 * band**8)
    detector = rng.standard_normal((n, n_bands), dtype=np.float32)
    detector *= 0.002 + 0.006 * band**6
    detector += 1.0
    detector *= values
    detector *= cells[:, None]
    offset = rng.standard_normal((n, n_bands), dtype=np.float32)
    offset *= dark
    detector += offset
    return np.maximum(detector, 0.0, out=detector)
