"""A material from one photograph of its ball: errors of left-out materials, by light, noise, exposure and turn.

    python benchmarks/bench_photo.py FOLDER                    # of .bsdf files: five lights, and variants in the first
    python benchmarks/bench_photo.py FOLDER --lights sky room --variants --expected
    python benchmarks/bench_photo.py FOLDER --lights overcast --every 3 --json FILE      # rows are added to those there
    python benchmarks/bench_photo.py FOLDER --together        # twelve readings, one photograph, and both
    python benchmarks/bench_photo.py built-in                  # of the built-in library
    python benchmarks/bench_photo.py --spectral                # spectra of the built-in corpus from RGB pictures

Mitsuba renders the ball of every file, 256 pixels across, with noise, clipped at display white; what was found without
that file is compared as a ball in the judged lights. Negative values of files are cut, as in a library. Light and
outline are given, so that no picture is refused and every row is over all chosen files.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import spearmanr

from manifold.analytic.corpus import isotropic_materials, rgl_bands
from manifold.brdf.plausibility import plausibility_of_file
from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.colour.reflectances import srgb_spectra
from manifold.core import shipped
from manifold.core.metrics import Errors
from manifold.core.records import Array
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.channels import srgb_responses, wiener_matrix
from manifold.estimate.completion import Completion
from manifold.estimate.expected import calibrate, errors_of_weights
from manifold.estimate.outlines import Circle, Photograph
from manifold.estimate.pixels import Camera, Environment, blocks_of
from manifold.estimate.sightings import Sighting
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import read_bsdf, write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.comparison import brdf_errors
from manifold.model.output_file import output_file
from manifold.model.prediction import ClippedBRDF
from manifold.model.reconstruction import ComparedValues
from manifold.render.render import render_floating_ball

SIZE, MARGIN, CAMERA = 256, 0.05, Camera(0.0, 15.0, 8.0)

KINDS = ("ball", "cube_root", "linear")


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
    return Photograph(Path("render"), values.astype(np.float32), noisy >= shot.clip)


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


def found(atoms: LibraryAtoms, m: int, seen: Sighting, shot: Shot) -> Completion:
    """Material m, found by all others."""
    without = atoms.without(m)
    exposure = 1.0 if shot.is_exposure_known else None
    return Completion.of(without, [seen], exposure=exposure)


def three(found: Errors[float]) -> tuple[float, float, float]:
    """Errors in the order of `KINDS`."""
    return found.ball, found.cube_root, found.linear


def errors(atoms: LibraryAtoms, m: int, weights: Array) -> tuple[float, float, float]:
    """Of weights of the atoms without material m."""
    every = np.zeros((3, len(atoms)))
    every[:, atoms.material_of != m] = weights
    return three(errors_of_weights(atoms, m, every))


def nearest(atoms: LibraryAtoms, m: int) -> tuple[float, float, float]:
    """Errors of the material whose ball is nearest: what a perfect search among the others would find."""
    others = [k for k in range(len(atoms.names)) if k != m]
    tried = []
    for k in others:
        weights = np.zeros((3, len(atoms)))
        weights[np.arange(3), 3 * k + np.arange(3)] = 1.0
        tried.append(three(errors_of_weights(atoms, m, weights)))
    return min(tried)


def reconstructed(atoms: LibraryAtoms, m: int) -> tuple[float, float, float]:
    """Errors of `reconstruct` from all measured directions, among them the light in which balls are compared."""
    compared, without = ComparedValues.default(True), atoms.without(m)
    others = without.materials[: len(without.names)]
    is_used = np.ones(len(without), bool)
    is_used[without.n_measured : len(without.mixed) - 1] = False  # coats
    weights = np.zeros((3, len(without)))
    weights[:, is_used] = compared.weights(compared.of_atoms(others), atoms.materials[m])
    return errors(atoms, m, weights)


def together(
    atoms: LibraryAtoms, m: int, seen: Sighting
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Errors of material m from the twelve readings of an MA-T12, from one photograph, and from both."""
    truth, without = atoms.materials[m], atoms.without(m)
    wi, wo = geometry_ma_t12()
    values = np.maximum(truth.eval(wi, wo), 0.0)
    readings = Readings("sample", "MA-T12", wi, wo, None, values)
    made = [
        Completion.of(replace(without, is_linear=False), readings).brdf,
        *(Completion.of(without, observed).brdf for observed in ([seen], [seen, readings])),
    ]
    found = [brdf_errors(truth, brdf) for brdf in made]
    first, second, third = map(three, found)
    return first, second, third


class Table:
    """Medians and 90th percentiles, printed and kept.

    Attributes:
        rows: by name.
    """

    def __init__(self, path: Path | None) -> None:
        """Continue the table of a file."""
        self._path = path
        self.rows: dict[str, dict[str, object]] = {}
        if path is not None and path.exists():
            self.rows = json.loads(path.read_text(encoding="utf-8"))
        print("| | ball CIEDE2000 | cube root | linear |\n|---|---|---|---|")

    def add(self, name: str, rows: list[tuple[float, ...]], **others: object) -> None:
        """Add errors of several materials: ball, cube root, linear, and albedo if it is there."""
        middle, most = np.median(rows, axis=0), np.percentile(rows, 90, axis=0)
        cells = " | ".join(f"{a:.2f} / {b:.2f}" for a, b in zip(middle[:3], most[:3], strict=True))
        row: dict[str, object] = {"files": len(rows)}
        for k, kind in enumerate(KINDS):
            row[kind] = {"median": round(middle[k], 3), "p90": round(most[k], 3)}
        if len(rows[0]) > 3:
            row["max_albedo"] = round(max(row[3] for row in rows), 3)
        self.rows[name] = row | others
        print(
            f"| {name} | {cells} | {' '.join(f'{key} {value}' for key, value in others.items())}", flush=True
        )
        if self._path is not None:
            self._path.write_text(json.dumps(self.rows, indent=1) + "\n", encoding="utf-8")


def expected_beside(true: list[tuple[float, ...]], expected: list[list[float]]) -> dict[str, object]:
    """Rank correlation of expected errors with true ones, and the share below twice the expected, by kind."""
    made: dict[str, object] = {}
    for k, kind in enumerate(KINDS):
        truth, guess = np.array(true)[:, k], np.array(expected)[:, k]
        made[f"rank_{kind}"] = round(float(spearmanr(guess, truth).statistic), 2)
        made[f"below_twice_{kind}"] = round(float(np.mean(truth < 2.0 * guess)), 2)
    return made


def real(folder: Path, options: argparse.Namespace) -> None:
    """The table of measured files."""
    if folder == shipped.BUILT_IN:
        with TemporaryDirectory() as temporary:
            library = Library(folder)
            for name in library.names:
                write_bsdf(Path(temporary, f"{name}_rgb.bsdf"), library.read(name))
            real(Path(temporary), options)
        return
    files = sorted(folder.glob("*.bsdf"))
    with TemporaryDirectory() as temporary:
        imported = Path(temporary) / "library.zarr"
        import_files(imported, files)
        atoms = LibraryAtoms.of_library(Library(imported)).in_values
    by_name = {read_bsdf(path).name: path for path in files}
    files = [by_name[name] for name in atoms.names]
    chosen = range(0, len(files), options.every)
    table, part = Table(options.json), f", one file in {options.every}" if options.every > 1 else ""
    if options.others:
        table.add(f"nearest material{part}", [nearest(atoms, m) for m in chosen])
        table.add(f"reconstruct{part}", [reconstructed(atoms, m) for m in chosen])
    for k, name in enumerate(options.lights):
        light = environment(name, 256)
        pictures = dict(zip(chosen, rendered([files[m] for m in chosen], light), strict=True))
        if options.together:
            rows = [together(atoms, m, sighting(picture, STANDARD, light)) for m, picture in pictures.items()]
            for kind, own in zip(
                ("twelve readings", "photograph", "both"), zip(*rows, strict=True), strict=True
            ):
                table.add(f"{name}: {kind}{part}", list(own))
            continue
        for shot in (STANDARD, *(VARIANTS if options.variants and k == 0 else ())):
            start, rows, expected = time.perf_counter(), [], []
            for m, picture in pictures.items():
                material = found(atoms, m, sighting(picture, shot, light), shot)
                row = errors(atoms, m, material.weights)
                if options.albedo and shot is STANDARD:
                    brdf = ClippedBRDF(material.brdf)
                    row += (plausibility_of_file(output_file(brdf, "found")[0]).max_albedo,)
                rows.append(row)
                if options.expected and shot is STANDARD:
                    calibration = calibrate(material.atoms, material.exposed)
                    expected.append(list(three(calibration.expected(material))))
            others = expected_beside(rows, expected) if expected else {}
            seconds = round((time.perf_counter() - start) / len(rows), 1)
            table.add(f"{name}, {shot.name}{part}", rows, **others, seconds=seconds)


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
    parser.add_argument("--others", action="store_true", help="`reconstruct` and the nearest material")
    parser.add_argument("--every", type=int, default=1, help="one file in this many")
    parser.add_argument("--json", type=Path, help="where rows are kept")
    parser.add_argument(
        "--together", action="store_true", help="readings and photograph, each alone and both"
    )
    parser.add_argument("--spectral", action="store_true")
    options = parser.parse_args()
    if options.spectral:
        spectral()
    if options.folder is not None:
        real(options.folder, options)


if __name__ == "__main__":
    main()
