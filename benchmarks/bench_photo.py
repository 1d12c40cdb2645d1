"""A material from one photograph of its ball: errors of left-out materials, by light, noise, exposure and turn.

    python benchmarks/bench_photo.py FOLDER                    # of .bsdf files: five lights, and variants in the first
    python benchmarks/bench_photo.py FOLDER --lights sky room --variants --expected
    python benchmarks/bench_photo.py --spectral                # spectra of the built-in corpus from RGB pictures

Mitsuba renders the ball of every file, 256 pixels across, with noise, clipped at display white; what was found without
that file is compared in another light: the studio turned by half a circle. Negative values of files are cut, as in a
library.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import spearmanr

from manifold.brdf.analytic.corpus import isotropic_materials, rgl_bands
from manifold.brdf.plausibility import plausibility_of_file
from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.colour.environments import ENVIRONMENTS, environment
from manifold.colour.reflectances import srgb_spectra
from manifold.completion.atoms import LibraryAtoms
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.output_file import output_file
from manifold.model.prediction import ClippedBRDF
from manifold.photo.atoms import PhotoAtoms
from manifold.photo.blocks import blocks_of
from manifold.photo.circle import Circle
from manifold.photo.light import Environment
from manifold.photo.material import PhotoMaterial, Sighting, errors_of, find_material
from manifold.photo.pictures import Photograph
from manifold.photo.pixels import Camera
from manifold.photo.spectra import srgb_responses, wiener_matrix
from manifold.records import Array
from manifold.rendering.render import render_floating_ball

SIZE, MARGIN, CAMERA = 256, 0.05, Camera(0.0, 15.0, 8.0)


@dataclass(frozen=True)
class Shot:
    """How a ball is photographed, and what is known of it.

    Attributes:
        name: for the table.
        noise: standard deviation relative to the pixel.
        clip: brightest value; infinite for an unclipped EXR.
        bits8: whether it is stored as 8-bit sRGB.
        is_exposure_known: or left free.
        turned_deg: error of the environment's azimuth.
    """

    name: str
    noise: float = 0.01
    clip: float = 1.0
    bits8: bool = False
    is_exposure_known: bool = True
    turned_deg: float = 0.0


STANDARD = Shot("1 % noise, clipped")
VARIANTS = (
    Shot("no noise", noise=0.0),
    Shot("5 % noise", noise=0.05),
    Shot("not clipped", clip=np.inf),
    Shot("8 bit", bits8=True),
    Shot("exposure free", is_exposure_known=False),
    Shot("turned by 2 degrees", turned_deg=2.0),
    Shot("turned by 5 degrees", turned_deg=5.0),
)


def photograph(linear: Array, shot: Shot) -> Photograph:
    """A render as a camera stores it."""
    noisy = linear * (1.0 + shot.noise * np.random.default_rng(0).standard_normal(linear.shape))
    values = np.clip(noisy, 0.0, shot.clip)
    if shot.bits8:
        values = decode_srgb(np.round(255.0 * encode_srgb(values)) / 255.0)
    return Photograph(Path("render"), values.astype(np.float32), (noisy >= shot.clip).any(axis=2))


def sighting(linear: Array, shot: Shot, light: Array) -> Sighting:
    """The ball in such a photograph."""
    circle = Circle(SIZE / 2, SIZE / 2, SIZE / 2 / (1.0 + MARGIN))
    camera = replace(CAMERA, turn_deg=shot.turned_deg)
    return Sighting(blocks_of(photograph(linear, shot), circle), camera, Environment.of(light))


def rendered(files: list[Path], light: Array) -> Iterator[Array]:
    """Balls of files without their negative values."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "material_rgb.bsdf"
        for each in files:
            file = read_bsdf(each)
            write_bsdf(path, replace(file, spectra=np.maximum(file.spectra, 0.0)))
            yield render_floating_ball(
                path, True, light, size=SIZE, samples=64, margin=MARGIN,
                elevation_deg=CAMERA.elevation_deg, distance=CAMERA.distance,
            )  # fmt: skip


def found(atoms: PhotoAtoms, m: int, seen: Sighting, shot: Shot) -> PhotoMaterial:
    """Material m, found by all others."""
    without = PhotoAtoms(atoms.library.without(m))
    exposure = 1.0 if shot.is_exposure_known else None
    return find_material(without, [seen], atoms.library.bands, np.eye(3), exposure=exposure)


def errors(atoms: PhotoAtoms, m: int, weights: Array) -> tuple[float, float, float]:
    """Of weights of the atoms without material m."""
    every = np.zeros((3, len(atoms)))
    every[:, atoms.without(m)] = weights
    return errors_of(atoms, 3 * m + np.arange(3), every)


def nearest(atoms: PhotoAtoms, m: int) -> tuple[float, float, float]:
    """Errors of the material whose ball is nearest: what a perfect search among the others would find."""
    others = [k for k in range(len(atoms.library.names)) if k != m]
    tried = []
    for k in others:
        weights = np.zeros((3, len(atoms)))
        weights[np.arange(3), 3 * k + np.arange(3)] = 1.0
        tried.append(errors_of(atoms, 3 * m + np.arange(3), weights))
    return min(tried)


def show(name: str, rows: list[tuple[float, ...]]) -> None:
    """Medians and 90th percentiles."""
    middle, most = np.median(rows, axis=0), np.percentile(rows, 90, axis=0)
    cells = " | ".join(f"{a:.2f} / {b:.2f}" for a, b in zip(middle[:3], most[:3], strict=True))
    largest = f" | albedo at most {np.max(rows, axis=0)[3]:.3f}" if len(rows[0]) > 3 else ""
    print(f"| {name} | {cells}{largest} |", flush=True)


def real(folder: Path, lights: list[str], with_variants: bool, with_expected: bool, albedo: bool) -> None:
    """The tables of measured files."""
    files = sorted(folder.glob("*.bsdf"))
    with TemporaryDirectory() as temporary:
        library = Path(temporary) / "library.zarr"
        import_files(library, files)
        atoms = PhotoAtoms(LibraryAtoms.of_library(Library(library)))
    by_name = {read_bsdf(path).name: path for path in files}
    files = [by_name[name] for name in atoms.library.names]
    print("| light | ball CIEDE2000 | cube root | linear |\n|---|---|---|---|")
    show("nearest material", [nearest(atoms, m) for m in range(len(files))])
    for k, name in enumerate(lights):
        light = environment(name, 256)
        pictures = list(rendered(files, light))
        for shot in (STANDARD, *(VARIANTS if with_variants and k == 0 else ())):
            start, rows, expected = time.perf_counter(), [], []
            for m, picture in enumerate(pictures):
                material = found(atoms, m, sighting(picture, shot, light), shot)
                row = errors(atoms, m, material.weights)
                if albedo and shot is STANDARD:
                    brdf = ClippedBRDF(material.brdf)
                    row += (plausibility_of_file(output_file(brdf, "found")[0]).max_albedo,)
                rows.append(row)
                if with_expected and shot is STANDARD:
                    expected.append(list(material.expected.values()))
            show(f"{name}, {shot.name}", rows)
            if expected:
                true = np.array(rows)[:, :3]
                for j, kind in enumerate(material.expected):
                    guess = np.array(expected)[:, j]
                    print(
                        f"  expected {kind}: rank correlation {spearmanr(guess, true[:, j]).statistic:.2f}, "
                        f"{np.mean(true[:, j] < 2.0 * guess):.0%} below twice the expected"
                    )
            print(f"  {(time.perf_counter() - start) / len(files):.1f} s a picture", flush=True)


def spectral() -> None:
    """Reflectances of the corpus from their linear sRGB: Wiener estimation without the material, and up-sampling."""
    bands = rgl_bands()
    wi, wo = (np.array([[np.sin(a), 0.0, np.cos(a)]]) for a in np.deg2rad([45.0, 0.0]))
    spectra = np.array([np.pi * material.truth().eval(wi, wo)[0] for material in isotropic_materials()])
    responses = srgb_responses(bands)
    nm = np.array(bands.wavelengths_nm)
    visible = (nm >= 400.0) & (nm <= 700.0)
    made = {"library": [], "up-sampling": []}
    for m, spectrum in enumerate(spectra):
        linear = responses @ spectrum
        matrix = wiener_matrix(np.delete(spectra, m, axis=0), responses)
        for kind, guess in (("library", matrix @ linear), ("up-sampling", linear @ srgb_spectra(bands))):
            wrong = np.linalg.norm((np.maximum(guess, 0.0) - spectrum)[visible])
            made[kind].append(wrong / np.linalg.norm(spectrum[visible]))
    for kind, values in made.items():
        print(f"{kind}: relative spectral error {np.median(values):.3f} / {np.percentile(values, 90):.3f}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--lights", nargs="+", default=list(ENVIRONMENTS), choices=ENVIRONMENTS)
    parser.add_argument(
        "--variants", action="store_true", help="noise, exposure, bits and turns, in the first light"
    )
    parser.add_argument("--expected", action="store_true", help="expected errors beside true ones")
    parser.add_argument("--albedo", action="store_true", help="of written files")
    parser.add_argument("--spectral", action="store_true")
    options = parser.parse_args()
    if options.spectral:
        spectral()
    if options.folder is not None:
        real(options.folder, options.lights, options.variants, options.expected, options.albedo)


if __name__ == "__main__":
    main()
