"""Doubts about the pixels of photographs: saturation below the largest code, and pictures read in the wrong encoding.

    python benchmarks/bench_pixels.py FILES [--set FOLDER] [--every N] [--json FILE]     # saturation
    python benchmarks/bench_pixels.py FILES --encodings [--every N] [--json FILE]

Each .bsdf file is rendered as a ball under lamps, and stored in four forms: 14 bits in 16, 8 bits whose level is code
243, floats with 1 % noise after an interpolation of colours, and JPEG.

Saturated pictures clip each channel at the peak of the picture over 1.5 or 4. A hit is a picture of which at least
70 % of the clipped pixels are found. Pictures that clip nothing, under the lamps and in the environments, must have
none: each in which a pixel is found is a false alarm. Balls are also completed from a saturated picture without
their file: with bounds per channel as found, with clipped pixels taken as values, and from the whole picture.

Encodings are compared in pictures of sRGB or linear codes that state none: PNG of 8 bits, which is read as sRGB, and
TIFF of 16 bits, which is read as linear. With lamps given, the shares state how often `photograph` advises to read them
otherwise, and how often it blames a lamp instead. With lamps found, they state how often it advises to read three
pictures of a ball otherwise.

A set is a folder of real pictures of a ball under lamps: gray/*.png, chrome/*.png, lights.txt. Its figures are rates of
plateaus in the pictures as they are, and after clipping at one half of the largest code.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tifffile
from PIL import Image
from scipy.ndimage import convolve

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import encode_srgb
from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.estimate.expected import errors_of_weights
from manifold.estimate.lamps import Lamp, lamp_picture
from manifold.estimate.outlines import Circle, Photograph, read_photograph
from manifold.estimate.pixels import Camera, blocks_of
from manifold.estimate.sightings import PhotoRequest, Sighting, see
from manifold.io_rgl import material_name, read_bsdf
from manifold.render.render import render_floating_ball

SIZE, MARGIN = 200, 0.05
CIRCLE = Circle(SIZE / 2, SIZE / 2, SIZE / 2 / (1.0 + MARGIN))
LAMPS = ((0.0, 0.0, 1.0), (0.5, 0.3, 1.0), (-0.8, 0.4, 0.6))
LEVELS = (1.5, 4.0)  # ratios of a picture's peak to the level at which it clips
ENOUGH = 0.7  # share of the clipped pixels
FEWEST = 20  # clipped pixels of a picture that counts
OFF_DEG = (0.0, 20.0)  # errors of the given lamps
_COLOURS = np.outer([1, 2, 1], [1, 2, 1]) / 16.0  # interpolation of a Bayer pattern

Writer = Callable[[Path, Array, np.random.Generator], Path]


# -- forms of pictures, whose level is 1 ------------------------------------------------------------------------------


def write_fourteen_bits(path: Path, picture: Array, rng: np.random.Generator) -> Path:
    """Write 14-bit codes in 16 bits."""
    return _tiff(path, np.rint(16383 * picture).astype(np.uint16))


def write_eight_bits(path: Path, picture: Array, rng: np.random.Generator) -> Path:
    """Write 8-bit sRGB codes, of which 243 is the level."""
    noisy = picture * (1.0 + 0.003 * rng.standard_normal(picture.shape))
    return _png(path, _codes(0.895 * noisy))


def write_floats(path: Path, picture: Array, rng: np.random.Generator) -> Path:
    """Write floats after an interpolation of colours, with 1 % noise."""
    mixed = np.stack([convolve(picture[..., c], _COLOURS, mode="nearest") for c in range(3)], axis=-1)
    noisy = 0.35 * mixed * (1.0 + 0.01 * rng.standard_normal(picture.shape))
    return _tiff(path, noisy.astype(np.float32))


def write_jpeg(path: Path, picture: Array, rng: np.random.Generator) -> Path:
    """Write a JPEG of quality 90."""
    target = path.with_suffix(".jpg")
    Image.fromarray(_codes(0.9 * picture)).save(target, quality=90)
    return target


FORMS: dict[str, Writer] = {
    "14_in_16_bits": write_fourteen_bits, "code_243": write_eight_bits, "noisy_floats": write_floats,
    "jpeg": write_jpeg,
}  # fmt: skip


def _codes(linear: Array) -> Array:
    return np.rint(255.0 * encode_srgb(np.clip(linear, 0.0, 1.0))).astype(np.uint8)


def _png(path: Path, codes: Array) -> Path:
    target = path.with_suffix(".png")
    Image.fromarray(codes).save(target)
    return target


def _tiff(path: Path, values: Array) -> Path:
    target = path.with_suffix(".tif")
    tifffile.imwrite(target, values, photometric="rgb")
    return target


# -- saturation -------------------------------------------------------------------------------------------------------


def saturation(pictures: Sequence[Array], lit: Sequence[Array], folder: Path) -> dict[str, Any]:
    """Return hits in saturated pictures, and false alarms in whole ones, by form, as shares with their counts."""
    rng, found = np.random.default_rng(0), {}
    for name, write in FORMS.items():
        hits, alarms, false = [], [], []
        for picture in (*pictures, *lit):
            whole = write(folder / "whole", picture / picture.max(), rng)
            alarms.append(bool(read_photograph(whole).is_clipped.any()))
        for picture in pictures:
            for ratio in LEVELS:
                level = picture.max() / ratio
                clipped = (picture > level).any(axis=2)
                if np.count_nonzero(clipped) < FEWEST:
                    continue
                file = write(folder / "clipped", np.minimum(picture / level, 1.0), rng)
                seen = read_photograph(file).is_clipped.any(axis=2)
                hits.append(np.count_nonzero(seen & clipped) >= ENOUGH * np.count_nonzero(clipped))
                false.append(np.count_nonzero(seen & ~clipped) / np.count_nonzero(clipped))
        lamps, lights = alarms[: len(pictures)], alarms[len(pictures) :]
        found[name] = {
            "hits": _share(hits), "saturated": len(hits), "beside": float(np.median(false)),
            "false_under_lamps": _share(lamps), "whole_under_lamps": len(lamps),
            "false_in_lights": _share(lights), "whole_in_lights": len(lights),
        }  # fmt: skip
        print(f"{name:16}", *(f"{key} {value:.3g}" for key, value in found[name].items()), flush=True)
    return found


def bounds(files: Sequence[Path], pictures: Sequence[Array], folder: Path) -> dict[str, list[float]]:
    """Return ball errors of completions from one picture without its file: median and 90th percentile."""
    atoms = LibraryAtoms.of_library("built-in").in_values
    lamp, rng = Lamp.towards(np.array(LAMPS[1])), np.random.default_rng(1)
    errors: dict[str, list[float]] = {"whole": [], "bounds": [], "values": []}
    for file, picture in zip(files, pictures, strict=True):
        m = atoms.names.index(material_name(file))
        peak, level = picture.max(), picture.max() / LEVELS[-1]
        whole = read_photograph(write_fourteen_bits(folder / "whole", picture / peak, rng))
        found = read_photograph(
            write_fourteen_bits(folder / "clipped", np.minimum(picture / level, 1.0), rng)
        )
        taken = Photograph(found.path, found.values, np.zeros_like(found.is_clipped))
        of_codes = 16383.0 / 65535.0
        for name, photograph, scale in (
            ("whole", whole, peak),
            ("bounds", found, level),
            ("values", taken, level),
        ):
            sighting = Sighting(blocks_of(photograph, CIRCLE), Camera(), (lamp,))
            completed = Completion.of(atoms.without(m), [sighting], exposure=of_codes / scale)
            weights = np.zeros((3, len(atoms)))
            weights[:, atoms.material_of != m] = completed.weights
            errors[name].append(errors_of_weights(atoms, m, weights).ball)
    for name, values in errors.items():
        print(
            f"one saturated picture, {name:8} ball error {np.median(values):.2f} / {np.percentile(values, 90):.2f}"
        )
    return {name: [float(np.median(v)), float(np.percentile(v, 90))] for name, v in errors.items()}


def in_environments(files: Sequence[Path]) -> list[Array]:
    """Return balls of files in the environments of the package."""
    view = {"margin": MARGIN, "turn_deg": 0.0, "elevation_deg": 0.0, "distance": np.inf}
    return [
        render_floating_ball(file, True, environment(name).astype(float), size=SIZE, samples=32, **view)
        for file in files
        for name in ENVIRONMENTS
    ]


# -- encoding ---------------------------------------------------------------------------------------------------------


def encodings(balls: Sequence[Sequence[Array]], folder: Path) -> dict[str, Any]:
    """Return shares of hints and of blamed lamps, by the codes and how they are read; lamps given, and found."""
    rng, found = np.random.default_rng(2), {}
    for are_linear in (False, True):
        for is_read_linear in (False, True):
            key = f"{_coding(are_linear)}_read_as_{_coding(is_read_linear)}"
            rows: dict[str, list[bool]] = {}
            for ball in balls:
                files = [
                    _stored(folder / f"{k}", picture, are_linear, is_read_linear)
                    for k, picture in enumerate(ball)
                ]
                for name, hinted, blamed in _doubts(files, rng):
                    rows.setdefault(f"hints_{name}", []).append(hinted)
                    rows.setdefault(f"blames_{name}", []).append(blamed)
            found[key] = {name: _share(values) for name, values in rows.items()}
            found[key] |= {
                "pictures": len(rows["hints_off_by_0"]),
                "refused": len(balls) - len(rows.get("hints_found", [])),
            }
            print(f"{key:24}", *(f"{name} {value:.3g}" for name, value in found[key].items()), flush=True)
    return found


def _doubts(files: Sequence[Path], rng: np.random.Generator) -> Iterator[tuple[str, bool, bool]]:
    """Yield what lamps were given, whether the encoding is doubted, and whether a lamp is, for pictures of a ball."""
    for off in OFF_DEG:
        for file, lamp in list(zip(files, LAMPS, strict=True))[: 1 if off else None]:
            given = ",".join(f"{v:.6f}" for v in _turned(np.array(lamp), off, rng))
            (ball,) = see(PhotoRequest([file], circles=[str(CIRCLE)], lamps=[given], each=None))
            yield f"off_by_{off:g}", bool(ball.warnings), any("looks lit from" in note for note in ball.notes)
    try:
        ball, *_ = see(PhotoRequest(files, circles=[str(CIRCLE)], lamps=["found"], each=None))
    except UsageError:  # no single lamp explains the pictures
        return
    yield "found", bool(ball.warnings), False


def _stored(path: Path, picture: Array, is_linear: bool, is_read_linear: bool) -> Path:
    """Write codes, linear or sRGB, at the exposure at which 1 % of the ball is nearly white; see the module."""
    exposed = 0.9 * picture / np.quantile(picture[picture.max(axis=2) > 0.0], 0.99)
    values = np.clip(exposed, 0.0, 1.0) if is_linear else encode_srgb(np.clip(exposed, 0.0, 1.0))
    if is_read_linear:
        return _tiff(path, np.rint(65535.0 * values).astype(np.uint16))
    return _png(path, np.rint(255.0 * values).astype(np.uint8))


def _turned(direction: Array, off_deg: float, rng: np.random.Generator) -> Array:
    """Return a direction turned by an angle to a random side."""
    unit = direction / np.linalg.norm(direction)
    aside = rng.standard_normal(3)
    aside -= aside @ unit * unit
    return np.cos(np.deg2rad(off_deg)) * unit + np.sin(np.deg2rad(off_deg)) * aside / np.linalg.norm(aside)


def _coding(is_linear: bool) -> str:
    return "linear" if is_linear else "srgb"


# -- real pictures ----------------------------------------------------------------------------------------------------


def real(folder: Path, work: Path) -> dict[str, Any]:
    """Return plateaus in pictures of a set, as they are and clipped at one half of their peak."""
    found: dict[str, Any] = {}
    for ball in ("gray", "chrome"):
        files = [path for path in sorted((folder / ball).glob("*.png")) if "mask" not in path.name]
        as_they_are = [_plateaus(read_photograph(path, is_linear=True)) for path in files]
        hits = []
        for path in files:
            codes = np.asarray(Image.open(path).convert("RGB"))
            level = codes.max() // 2
            clipped = (codes >= level).any(axis=2)
            seen = read_photograph(
                _png(work / "real", np.minimum(codes, level)), is_linear=True
            ).is_clipped.any(axis=2)
            hits.append(np.count_nonzero(seen & clipped) >= ENOUGH * np.count_nonzero(clipped))
        found[ball] = {
            "pictures": len(files),
            "with_plateaus": sum(as_they_are),
            "hits_when_clipped": _share(hits),
        }
        print(f"{ball}: {found[ball]}")
    return found


def _plateaus(photograph: Photograph) -> bool:
    """Return whether a photograph has a plateau below the largest code."""
    return any("plateau" in note for note in photograph.notes)


def _share(found: Iterable[bool]) -> float:
    return float(np.mean(list(found)))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of .bsdf files of the built-in library")
    parser.add_argument("--set", type=Path, help="folder of real pictures of a ball")
    parser.add_argument("--encodings", action="store_true", help="in place of saturation")
    parser.add_argument("--every", type=int, default=1, help="one file in this many")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    files = sorted(options.folder.glob("*.bsdf"))[:: options.every]
    lamps = [Lamp.towards(np.array(lamp)) for lamp in LAMPS]
    balls = []
    for file in files:
        brdf = MeasuredBRDF(read_bsdf(file))
        balls.append([np.maximum(lamp_picture(brdf, Camera(), [one], SIZE, MARGIN), 0.0) for one in lamps])
    with TemporaryDirectory() as folder:
        work = Path(folder)
        found: dict[str, Any] = {"files": len(files)}
        if options.encodings:
            found |= encodings(balls, work)
        else:
            pictures = [picture for ball in balls for picture in ball]
            found["saturation"] = saturation(pictures, in_environments(files), work)
            found["bounds"] = bounds(files, [ball[1] for ball in balls], work)
        if options.set is not None:
            found["set"] = real(options.set, work)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
