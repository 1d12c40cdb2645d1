"""Photographs under lamps: what is found in real pictures of a ball, and in rendered ones of materials left out.

    python benchmarks/bench_lamps.py --set FOLDER --library library.zarr     # gray/*.png, chrome/*.png, lights.txt
    python benchmarks/bench_lamps.py --files FOLDER --library library.zarr   # .bsdf files, rendered by Mitsuba
    python benchmarks/bench_lamps.py --files FOLDER --library library.zarr --wrong --expected --together
    python benchmarks/bench_lamps.py --stated --set FOLDER --files FOLDER    # only the uncertainty of lamps

A set is one of photometric stereo: pictures of a ball under lamps of known directions. Lamps are found in one, three,
five pictures of it, and the others predicted; each may have a gain, and is compared in display values within the ball.

Files are photographed in a dark room: 8-bit JPEG of random gain, the ball off the middle. What is found without the
file is compared as a ball in the judged lights. The analytic fits see the same pixels and the true lamps.

`--stated` holds the stated uncertainty of lamps to their errors: how many lie within it, within twice, and the rank
correlation, by number of pictures; for files also if the codes are linear but read as sRGB.

Pictures in which no lamp is found are refused, and the message asks for the lamps. `with_refused` gives them the error
of the same pictures with the lamps given, so that these rows are over all files.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize_scalar
from scipy.stats import spearmanr

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.wrapper import WrappedBRDF
from manifold.colour.conversion import encode_srgb
from manifold.core.errors import ManifoldError
from manifold.core.records import Array
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.channels import Channels
from manifold.estimate.completion import Completion
from manifold.estimate.lamps import Lamp, lamp_pairs, read_lamps
from manifold.estimate.light_probe import find_light
from manifold.estimate.outlines import Circle, Photograph, read_photograph
from manifold.estimate.pixels import Camera, blocks_of, frames
from manifold.estimate.sightings import PhotoRequest, Sighting, see
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import fit_bsdf
from manifold.formats.readings import Readings, geometry_ma_t12
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model.comparison import brdf_errors
from manifold.model.prediction import ClippedBRDF
from manifold.render import backend, bsdf_parameters
from manifold.render.fitted_brdf import FittedBRDF
from manifold.render.images import ciede2000_map

FAMILIES = ("lambertian", "principled")
COUNTS = {"sun": (1, 2, 3, 5, 8), "torch": (1, 3), "flash": (1,)}
FITTED = (1, 3)  # numbers of pictures to which `principled` is fitted
SET_COUNTS = (1, 3, 5)
STATED = (1, 3)  # numbers of pictures whose lamps are held to their stated uncertainty
DISTANCE = 10.0  # radii: a torch 40 cm from a ball of 8 cm
ASIDE = ", brightness aside"  # of what is found under an unknown exposure
SIZE, RADIUS = 240, 80.0  # pixels
DIRECTIONS = np.array(
    [[0.5, 0.5, 0.7], [-0.7, 0.5, 0.3], [0.3, -0.8, 0.4], [0.9, -0.1, 0.15], [-0.2, 0.1, 0.95],
     [-0.5, -0.3, 0.8], [0.1, 0.7, 0.7], [0.6, -0.4, 0.6]]
)  # fmt: skip
CARD = (6, 6, 30, 30)  # of the picture; reflectance 0.18


@dataclass(frozen=True)
class Shot:
    """A kind of photographs, and what is told of them.

    Attributes:
        name: for the table.
        light: sun, torch or flash.
        knows: geometry, card, or nothing.
    """

    name: str
    light: str
    knows: str


SHOTS = tuple(
    Shot(f"{light}, {knows}", light, knows)
    for light, kinds in (
        ("sun", ("geometry", "geometry and card", "nothing", "card")),
        ("torch", ("geometry", "geometry and card", "nothing", "card")),
        ("flash", ("geometry", "geometry and card")),
    )
    for knows in kinds
)
INSTEAD = {"nothing": "geometry", "card": "geometry and card"}
"""What users give if the lamps are not found, by what they gave before."""


@dataclass(frozen=True)
class Material:
    """A library's atoms without a file, and the truth."""

    atoms: LibraryAtoms
    library: Library
    truth: MeasuredBRDF

    @property
    def channels(self) -> Channels:
        """Those of linear sRGB, and the bands of the library."""
        return Channels.of_library(self.library, self.atoms.names)

    def found(self, balls: Sequence[Sighting | Readings], exposure: float | None, each: bool) -> Completion:
        """What is found without the file."""
        return Completion.of(self.atoms, balls, exposure=exposure, each=each, channels=self.channels)

    def ball(self, material: Completion) -> float:
        """Its error in the judged lights."""
        return brdf_errors(self.truth, ClippedBRDF(material.brdf)).ball

    def ball_aside(self, material: Completion) -> float:
        """Its error at the exposure at which that is least."""
        made = ClippedBRDF(material.brdf)
        return float(
            minimize_scalar(
                lambda log: brdf_errors(self.truth, _Scaled(made, np.exp(log))).ball,
                bounds=(-2.5, 2.5), method="bounded", options={"xatol": 0.02},
            ).fun
        )  # fmt: skip


class _Scaled(WrappedBRDF):
    """A BRDF times a factor."""

    def __init__(self, brdf: BRDF, factor: float):
        super().__init__(brdf)
        self._factor = factor

    def eval(self, wi: Array, wo: Array) -> Array:
        return self._factor * self._brdf.eval(wi, wo)

    def albedo(self, wi: Array) -> Array:
        return self._factor * self._brdf.albedo(wi)


# -- a real set -------------------------------------------------------------------------------------------------------


def real(folder: Path, library: Path) -> None:
    """Tables of a set of photometric stereo."""
    opened = Library(library)
    atoms = LibraryAtoms.of_library(opened).in_values
    one = Material(atoms, opened, MeasuredBRDF(opened.read(atoms.names[0])))
    known = read_lamps(folder / "lights.txt")
    pictures = [read_photograph(folder / "gray" / f"gray.{k}.png", is_linear=True) for k in range(len(known))]
    every = find_light(pictures)
    mirrored = _mirrored(folder / "chrome", len(known))
    for name, lamps, truth in (
        ("found, from lights.txt", every.lamps, known),
        ("found, from the mirror ball", every.lamps, mirrored),
        ("lights.txt, from the mirror ball", known, mirrored),
    ):
        off = [_apart(lamp, true) for lamp, true in zip(lamps, truth, strict=True)]
        print(
            f"all {len(pictures)}, circle {every.circle}: {name} {np.median(off):.1f}, at most {max(off):.1f} degrees"
        )
    rng = np.random.default_rng(7)
    for count in SET_COUNTS:
        errors: dict[str, list[float]] = {name: [] for name in ("found", *FAMILIES)}
        lamps_off: list[float] = []
        for _ in range(6):
            some = np.sort(rng.choice(len(pictures), count, replace=False))
            probe = find_light([pictures[k] for k in some])
            lamps_off += [_apart(lamp, known[k]) for lamp, k in zip(probe.lamps, some, strict=True)]
            seen = [
                Sighting(blocks_of(pictures[k], probe.circle), Camera(), (lamp,))
                for lamp, k in zip(probe.lamps, some, strict=True)
            ]
            material = one.found(seen, None, True)
            models = {"found": lambda wi, wo, m=material: np.maximum(m.brdf.eval(wi, wo), 0.0)}
            gains = np.array(probe.gains)
            for name in FAMILIES:
                models[name] = _analytic(name, seen, 1.0 / gains).eval
            for k in set(range(len(pictures))) - set(some.tolist()):
                for name, model in models.items():
                    errors[name].append(_predicted(pictures[k], every.circle, every.lamps[k], model))
        print(
            f"{count} pictures: lamps off by {np.median(lamps_off):.1f}, at most {max(lamps_off):.1f} degrees; others "
            + ", ".join(f"{name} {np.median(of):.2f}" for name, of in errors.items())
        )


def _mirrored(folder: Path, count: int) -> list[Lamp]:
    """Lamps as a chrome ball with a mask shows them: at its brightest spot."""
    with Image.open(folder / "chrome.mask.png") as mask:
        rows, columns = np.nonzero(np.asarray(mask.convert("L")) > 127)
    centre = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2.0
    radius = (np.ptp(columns) + np.ptp(rows) + 2) / 4.0
    lamps = []
    for k in range(count):
        values = read_photograph(folder / f"chrome.{k}.png", is_linear=True).values.mean(axis=2)
        smooth = gaussian_filter(values, 1.5)[rows, columns]
        bright = smooth >= 0.8 * smooth.max()
        x, y = (np.stack([columns, rows])[:, bright].mean(axis=1) + 0.5 - centre) / [radius, -radius]
        z = np.sqrt(1.0 - x * x - y * y)
        lamps.append(Lamp.towards(2.0 * z * np.array([x, y, z]) - [0.0, 0.0, 1.0]))
    return lamps


def _apart(lamp: Lamp, other: Lamp) -> float:
    return float(np.rad2deg(np.arccos(np.clip(lamp.direction @ other.direction, -1.0, 1.0))))


def _predicted(picture: Photograph, circle: Circle, lamp: Lamp, model) -> float:
    """CIEDE2000 of a ball that was not seen, its gain free, in display values."""
    size = 96
    across = 2.0 * (np.arange(size) + 0.5) / size - 1.0
    x, y = np.meshgrid(across, -across)
    inside = np.hypot(x, y) < 0.95
    rows, columns = (
        np.floor(centre + sign * circle.radius * at[inside]).astype(int)
        for centre, sign, at in ((circle.y, -1.0, y), (circle.x, 1.0, x))
    )
    seen = picture.values[rows, columns]
    normal, view = Camera().surface(x[inside], y[inside])
    frame = frames(normal)
    towards = np.broadcast_to(lamp.direction @ np.array(Camera().axes), normal.shape)
    wi, wo = (np.einsum("kij,kj->ki", frame, w) for w in (view, towards))
    lit = wo[:, 2] > 1e-3
    made = np.zeros((len(wi), 3))
    made[lit] = model(wi[lit], wo[lit]) * wo[lit, 2:]
    used = lit & ~picture.is_clipped[rows, columns]
    gain = (
        np.sum(np.cbrt(made[used]) * np.cbrt(seen[used])) / max(np.sum(np.cbrt(made[used]) ** 2), 1e-12)
    ) ** 3
    level = float(np.quantile(seen, 0.995))
    shown = [encode_srgb(np.clip(v / level, 0.0, 1.0))[None] for v in (seen, gain * made)]
    return float(np.mean(ciede2000_map(*shown)))


def _analytic(name: str, seen: Sequence[Sighting], scales: Sequence[float]) -> FittedBRDF:
    """A BSDF of Mitsuba fitted to the middles of blocks of pixels, whose lamps and gains are known."""
    wi, wo, f = [], [], []
    for sighting, scale in zip(seen, scales, strict=True):
        a, b, light = lamp_pairs(sighting.blocks, sighting.camera, sighting.light)
        power = light.sum(axis=1).mean(axis=1)
        mean = [np.einsum("ksi,ks->ki", w, light.mean(axis=2)) for w in (a, b)]
        mean = [w / np.maximum(np.linalg.norm(w, axis=1, keepdims=True), 1e-12) for w in mean]
        used = (mean[1][:, 2] > 0.05) & (mean[0][:, 2] > 0.05) & ~sighting.blocks.is_clipped & (power > 0.02)
        wi.append(mean[0][used])
        wo.append(mean[1][used])
        f.append(np.maximum(scale * sighting.blocks.values[used] / power[used, None], 0.0))
    samples = FitSamples.from_arrays(np.vstack(wi), np.vstack(wo), np.vstack(f), weight=np.vstack(wo)[:, 2])
    family = bsdf_parameters.diffuse() if name == "lambertian" else None
    made = fit_bsdf(samples, family)
    return FittedBRDF.of(made.family, made.values, made.bands, made.spectra, 0.0)


# -- stated uncertainties ---------------------------------------------------------------------------------------------


def stated(folder: Path | None, files: Sequence[Path], path: Path | None) -> None:
    """Print and write how far lamps are off beside their stated uncertainty."""
    pairs: dict[str, list[tuple[float, float]]] = {}
    if folder is not None:
        known = read_lamps(folder / "lights.txt")
        mirrored = _mirrored(folder / "chrome", len(known))
        pictures = [folder / "gray" / f"gray.{k}.png" for k in range(len(known))]
        rng = np.random.default_rng(7)
        for count in SET_COUNTS:
            for _ in range(6):
                some = np.sort(rng.choice(len(pictures), count, replace=False)).tolist()
                for name, lamps in (("stated lamps", known), ("mirror ball", mirrored)):
                    pairs.setdefault(f"set, {name}, {count}", []).extend(
                        _stated([pictures[k] for k in some], [lamps[k] for k in some], is_linear=True)
                    )
    for file in files:
        with TemporaryDirectory() as made:
            for is_linear in (False, True):
                taken = _photographed(file, "sun", Path(made), is_linear=is_linear)
                for count in STATED:
                    for first in range(0, len(taken) - count + 1, count):
                        some = taken[first : first + count]
                        name = f"{'linear codes read as sRGB' if is_linear else 'files'}, {count}"
                        pairs.setdefault(name, []).extend(
                            _stated([one.path for one in some], [one.lamp for one in some])
                        )
        print(file.stem, flush=True)
    found = {}
    for name, of in pairs.items():
        off, said = np.array(of).reshape(-1, 2).T
        found[name] = {
            "lamps": len(off), "off": [float(np.median(off)), float(np.percentile(off, 90)), float(off.max())],
            "stated": float(np.median(said)), "within_once": float(np.mean(off <= said)),
            "within_twice": float(np.mean(off <= 2.0 * said)), "rank": float(spearmanr(off, said).statistic),
        }  # fmt: skip
        print(name, json.dumps(found[name]))
    if path is not None:
        path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def _stated(
    pictures: Sequence[Path], lamps: Sequence[Lamp], *, is_linear: bool = False
) -> list[tuple[float, float]]:
    """Errors of lamps and their stated uncertainties, in degrees; none where no lamp is found."""
    try:
        balls = see(PhotoRequest(pictures, lamps=["found"], is_linear=is_linear))
    except ManifoldError:
        return []
    return [
        (_apart(ball.lamps[0], lamp), ball.lamp_deg or 0.0) for ball, lamp in zip(balls, lamps, strict=True)
    ]


# -- rendered files ---------------------------------------------------------------------------------------------------


def rendered(files: Sequence[Path], library: Path, asked: argparse.Namespace) -> None:
    """Measure files that are left out."""
    opened = Library(library)
    atoms = LibraryAtoms.of_library(opened)
    measured = []
    for path in files:
        name = path.stem.removesuffix("_rgb")
        kept = None if asked.keep is None else asked.keep / f"{name}.json"
        if kept is None or not kept.exists():
            start = time.process_time()
            m = atoms.names.index(name)
            one = Material(atoms.without(m).in_values, opened, MeasuredBRDF(read_bsdf(path)))
            with TemporaryDirectory() as folder:
                of_file = _measured(one, path, Path(folder), asked) | {"seconds": time.process_time() - start}
            measured.append(of_file)
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps(of_file, indent=1) + "\n", encoding="utf-8")
        else:
            measured.append(json.loads(kept.read_text(encoding="utf-8")))
        last = {shot: list(of.values())[-1] for shot, of in measured[-1]["errors"].items()}
        print(f"{name}: " + ", ".join(f"{shot} {error:.1f}" for shot, error in last.items()), flush=True)
    _tables(measured, asked.lights, asked.json)


def _measured(one: Material, path: Path, folder: Path, asked: argparse.Namespace) -> dict[str, Any]:
    """Errors of one file by kind of photographs and their number, of analytic fits, and of lamps that are found."""
    taken = {light: _photographed(path, light, folder) for light in asked.lights}
    errors: dict[str, dict[str, float]] = {}
    fits: dict[str, dict[str, float]] = {}
    off: dict[str, dict[str, list[tuple[float, float]]]] = {}
    expected: dict[str, tuple[float, float]] = {}
    for shot in (shot for shot in SHOTS if shot.light in asked.lights):
        for count in COUNTS[shot.light]:
            balls, exposure = _seen(taken[shot.light][:count], shot)
            if balls is None:
                continue
            free = exposure is None
            material = one.found(balls, exposure, free or shot.knows in ("nothing", "geometry"))
            error = one.ball(material)
            errors.setdefault(shot.name, {})[str(count)] = error
            if free:
                errors.setdefault(f"{shot.name}{ASIDE}", {})[str(count)] = one.ball_aside(material)
            if shot.knows == "nothing":
                off.setdefault(shot.light, {})[str(count)] = _lamp_errors(balls, taken[shot.light])
            if asked.expected and count == 3 and shot.knows == "nothing":
                expected[shot.name] = error, material.expected.ball
            if shot.knows == "geometry and card" and count in FITTED:
                made = _analytic("principled", balls, np.ones(len(balls)))
                fits.setdefault(shot.light, {})[str(count)] = brdf_errors(one.truth, made).ball
    if asked.together:
        errors |= _together(one, taken["sun"][0])
    if asked.wrong:
        errors |= _wrong(one, taken["sun"])
    return {"errors": errors, "fits": fits, "off": off, "expected": expected}


def _tables(measured: Sequence[Mapping[str, Any]], lights: Sequence[str], path: Path | None) -> None:
    """Print and write medians and 90th percentiles over files, under some lights."""
    tables: dict[str, dict[str, list[float]]] = {}
    for title, kind in (("", "errors"), ("principled ", "fits")):
        for of_file in measured:
            for name, by_count in of_file[kind].items():
                if (light := name.partition(",")[0]) in COUNTS and light not in lights:
                    continue
                for count, error in by_count.items():
                    tables.setdefault(title + name, {}).setdefault(count, []).append(error)
    print("\nball in the judged lights, median / 90th percentile, by number of pictures (materials)")
    for name, by_count in tables.items():
        cells = [
            f"{count}: {np.median(of):.2f} / {np.percentile(of, 90):.2f} ({len(of)})"
            for count, of in by_count.items()
        ]
        print(f"{name}: " + ", ".join(cells))
    whole = with_refused([one["errors"] for one in measured], lights)
    print(f"\nthe same of all {len(measured)} materials; refused pictures count as if their lamps were given")
    for name, by_count in whole.items():
        cells = [
            f"{count}: {np.median(of):.2f} / {np.percentile(of, 90):.2f}" for count, of in by_count.items()
        ]
        print(f"{name}: " + ", ".join(cells))
    print("\nlamps found: degrees off, mean, median; by how many nearer to the camera, mean")
    lamps: dict[str, dict[str, dict[str, float]]] = {}
    for light in lights:
        for count in map(str, COUNTS[light]):
            pairs = [pair for one in measured for pair in one["off"].get(light, {}).get(count, ())]
            if pairs:
                apart, towards = np.array(pairs).T
                means = float(apart.mean()), float(np.median(apart)), float(towards.mean())
                lamps.setdefault(light, {})[f"of_{count}"] = dict(
                    zip(("mean", "median", "towards"), means, strict=True)
                )
                print(f"{light}, {count}: {means[0]:.2f}, {means[1]:.2f}, {means[2]:+.2f}")
    for name in dict.fromkeys(name for one in measured for name in one["expected"]):
        true, said = np.array([one["expected"][name] for one in measured if name in one["expected"]]).T
        print(
            f"expected, {name}: {np.mean(true < 2.0 * said):.0%} below twice, rank correlation "
            f"{spearmanr(true, said).statistic:.2f}"
        )
    if path is not None:
        made: dict[str, object] = {_key(k): _summary(of) for k, of in tables.items() if ":" not in k}
        made["with_refused"] = {_key(name): _summary(of) for name, of in whole.items()}
        made["lamps_off"] = lamps
        path.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


def with_refused(
    errors: Sequence[Mapping[str, Mapping[str, float]]], lights: Sequence[str]
) -> dict[str, dict[str, list[float]]]:
    """Errors of every file by kind of photographs and their number; refused ones have those with given lamps."""
    return {
        shot.name + aside: {
            str(count): [_or_instead(of_file, shot, aside, str(count)) for of_file in errors]
            for count in COUNTS[shot.light]
        }
        for shot in SHOTS
        if shot.light in lights
        for aside in ("", ASIDE)
        if not aside or any(shot.name + aside in of_file for of_file in errors)
    }


def _or_instead(of_file: Mapping[str, Mapping[str, float]], shot: Shot, aside: str, count: str) -> float:
    error = of_file.get(shot.name + aside, {}).get(count)
    if error is None and shot.knows in INSTEAD:
        error = of_file.get(f"{shot.light}, {INSTEAD[shot.knows]}{aside}", {}).get(count)
    if error is None:
        raise ValueError(f"{shot.name}, {count}: refused although the lamps are given")
    return error


def _key(name: str) -> str:
    return "_".join(name.replace(",", "").replace(" and ", " ").split())


def _lamp_errors(balls: Sequence[Sighting], taken: Sequence[Taken]) -> list[tuple[float, float]]:
    """Degrees between lamps and true ones, and by how many these are nearer to the camera's axis."""
    made = []
    for ball, one in zip(balls, taken, strict=False):
        (lamp,) = ball.light
        slants = [float(np.rad2deg(np.arccos(each.direction[2]))) for each in (one.lamp, lamp)]
        made.append((_apart(lamp, one.lamp), slants[0] - slants[1]))
    return made


def _summary(of: Mapping[str, Sequence[float]]) -> dict[str, object]:
    """Median and 90th percentile, and of how many materials, by the number of pictures."""
    errors = {f"of_{n}": [float(np.median(e)), float(np.percentile(e, 90))] for n, e in of.items()}
    return errors | {f"materials_{n}": len(e) for n, e in of.items()}


@dataclass(frozen=True)
class Taken:
    """A photograph in a file, and how it was taken."""

    path: Path
    lamp: Lamp
    gain: float


CIRCLE = Circle(SIZE / 2 + 9.0, SIZE / 2 - 6.0, RADIUS)


def _photographed(path: Path, light: str, folder: Path, *, is_linear: bool = False) -> list[Taken]:
    """JPEG files of a ball under one lamp each, in sRGB, or in linear codes."""
    rng = np.random.default_rng(3)
    taken = []
    for k, direction in enumerate(DIRECTIONS[: 1 if light == "flash" else None]):
        direction = direction / np.linalg.norm(direction)
        if light == "flash":
            direction = np.array([0.0, 0.0, 1.0])
        lamp = Lamp(direction, np.inf if light == "sun" else DISTANCE)
        linear = _render(path, lamp)
        x, y, width, height = CARD
        linear[y : y + height, x : x + width] = 0.18 * max(float(direction[2]), 0.0)
        gain = (
            0.85 / max(float(np.quantile(linear, 0.995)), 1e-6) * float(np.exp(0.3 * rng.standard_normal()))
        )
        gain = min(gain, 0.9 / 0.18)  # the card is not clipped
        noisy = linear * gain * (1.0 + 0.01 * rng.standard_normal(linear.shape))
        file = folder / f"{light}_{k}.jpg"
        shown = np.clip(noisy, 0.0, 1.0)
        codes = np.rint(255.0 * (shown if is_linear else encode_srgb(shown))).astype(np.uint8)
        Image.fromarray(codes).save(file, quality=92, subsampling=0)
        taken.append(Taken(file, lamp, gain))
    return taken


def _render(path: Path, lamp: Lamp) -> Array:
    """The ball of a file under a lamp in black surroundings, relative to a white diffuser that faces the lamp."""
    mi = backend.mitsuba("rgb")
    to = lamp.direction.tolist()
    if np.isinf(lamp.distance):
        emitter = {
            "type": "directional",
            "direction": [-v for v in to],
            "irradiance": {"type": "rgb", "value": np.pi},
        }
    else:
        place = [lamp.distance * v for v in to]
        power = np.pi * lamp.distance**2
        emitter = {"type": "point", "position": place, "intensity": {"type": "rgb", "value": power}}
    half = SIZE / 2 / RADIUS
    shift = [(CIRCLE.x - SIZE / 2) / RADIUS, (SIZE / 2 - CIRCLE.y) / RADIUS]
    T = mi.ScalarTransform4f
    camera = T().look_at([-shift[0], -shift[1], 50.0], [-shift[0], -shift[1], 0.0], [0, 1, 0]) @ T().scale(
        [half, half, 1.0]
    )
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
            "sensor": {
                "type": "orthographic", "to_world": camera, "near_clip": 1.0, "far_clip": 100.0,
                "film": {
                    "type": "hdrfilm", "width": SIZE, "height": SIZE, "pixel_format": "rgb", "rfilter": {"type": "box"}
                },
            },
            "ball": {"type": "sphere", "bsdf": {"type": "measured", "filename": str(path)}},
            "lamp": emitter,
        }
    )  # fmt: skip
    picture = np.array(mi.render(scene, spp=32, seed=1), dtype=np.float64)
    return np.nan_to_num(np.maximum(picture, 0.0))


def _seen(taken: Sequence[Taken], shot: Shot) -> tuple[list[Sighting] | None, float | None]:
    """Balls as `see` finds them with what a shot tells, and the exposure; None where none are found."""
    paths = [one.path for one in taken]
    knows_lamps = shot.knows.startswith("geometry")
    card = "card" in shot.knows
    grey = f"{CARD[0] + 2},{CARD[1] + 2},{CARD[2] - 4},{CARD[3] - 4},0.18" if card else None
    if card and any(one.lamp.direction[2] < 0.05 for one in taken):
        grey, card = None, False  # lit from behind, the card says nothing
    lamps = (
        [
            ",".join(str(v) for v in (*one.lamp.direction, one.lamp.distance) if np.isfinite(v))
            for one in taken
        ]
        if knows_lamps
        else ["found" if np.isinf(taken[0].lamp.distance) else f"found,{taken[0].lamp.distance:g}"]
    )
    circle = [str(CIRCLE)] if knows_lamps else []
    try:
        balls = see(PhotoRequest(paths, circles=circle, lamps=lamps, grey=grey))
    except ManifoldError as error:
        print(f"    {shot.name}, {len(taken)}: {error}")
        return None, None
    return [ball.sighting for ball in balls], 1.0 if card else None


def _together(one: Material, taken: Taken) -> dict[str, dict[str, float]]:
    """Twelve readings, one picture with a card, and both."""
    wi, wo = geometry_ma_t12()
    read = Readings("left out", "twelve", wi, wo, None, np.maximum(one.truth.eval(wi, wo), 0.0))
    balls, exposure = _seen([taken], Shot("", "sun", "geometry and card"))
    assert balls is not None
    of_readings = Completion.of(replace(one.atoms, is_linear=False), read)
    alone = brdf_errors(one.truth, ClippedBRDF(of_readings.brdf)).ball
    errors = {"together: twelve readings": {"0": alone}}
    for name, seen in (("picture", balls), ("readings and picture", [*balls, read])):
        material = one.found(seen, exposure, False)
        errors[f"together: {name}"] = {"1": one.ball(material)}
    return errors


def _wrong(one: Material, taken: Sequence[Taken]) -> dict[str, dict[str, float]]:
    """One picture with a card, told wrongly: error of the ball, and how often a note says so."""
    first, errors = taken[0], dict[str, dict[str, float]]()
    values = read_photograph(first.path)
    for name, circle, lamp, change in (
        ("right", CIRCLE, first.lamp, lambda v: v),
        ("lamp 10 degrees off", CIRCLE, _turned(first.lamp, 10.0), lambda v: v),
        ("lamp 30 degrees off", CIRCLE, _turned(first.lamp, 30.0), lambda v: v),
        ("radius + 5 %", Circle(CIRCLE.x, CIRCLE.y, 1.05 * RADIUS), first.lamp, lambda v: v),
        ("ambient + 10 %", CIRCLE, first.lamp, lambda v: v + 0.1 * v.mean(axis=(0, 1)) * 4.0),
        ("tone curve", CIRCLE, first.lamp, lambda v: v / (0.35 + 0.65 * v)),
        ("two lamps", CIRCLE, first.lamp, lambda v: v + 0.5 * read_photograph(taken[1].path).values),
    ):
        changed = np.clip(change(values.values.astype(float)), 0.0, 1.0)
        file = first.path.with_name("wrong.png")
        Image.fromarray(np.rint(255.0 * encode_srgb(changed)).astype(np.uint8)).save(file)
        x, y, w, h = CARD
        grey = f"{x + 2},{y + 2},{w - 4},{h - 4},0.18"
        text = ",".join(str(v) for v in lamp.direction)
        try:
            (ball,) = see(PhotoRequest([file], circles=[str(circle)], lamps=[text], grey=grey))
            material = one.found([ball.sighting], 1.0, False)
        except ManifoldError:
            continue
        notes = (*ball.notes, *material.notes)
        said = any(
            word in note for note in notes for word in ("was given", "no material explains", "lie on it")
        )
        errors[f"wrong: {name}"] = {"1": one.ball(material)}
        errors[f"noted: {name}"] = {"1": float(said)}
    return errors


def _turned(lamp: Lamp, degrees: float) -> Lamp:
    beside = np.cross(lamp.direction, [0.0, 1.0, 0.0])
    turn = np.deg2rad(degrees)
    return Lamp(np.cos(turn) * lamp.direction + np.sin(turn) * beside / np.linalg.norm(beside), lamp.distance)


def cost(library: Path) -> None:
    """Seconds and memory of 1 and 10 pictures of 12 megapixels."""
    from manifold.estimate import completions

    with TemporaryDirectory() as folder:
        paths = []
        rng = np.random.default_rng(0)
        y, x = (np.mgrid[:3000, :4000] - np.array([1500, 2000])[:, None, None]) / 1100.0
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
        for k in range(10):
            lamp = np.array([*rng.uniform(-0.6, 0.6, 2), 0.8])
            lamp /= np.linalg.norm(lamp)
            shade = np.where(z > 0.0, np.maximum(x * lamp[0] - y * lamp[1] + z * lamp[2], 0.0), 0.0)
            path = Path(folder) / f"{k}.png"
            codes = np.rint(255.0 * encode_srgb(0.8 * shade[..., None] * np.array([0.6, 0.4, 0.3]))).astype(
                np.uint8
            )
            Image.fromarray(codes).save(path, compress_level=1)
            paths.append(path)
        for count in (1, 10):
            start = time.perf_counter()
            request = PhotoRequest(paths[:count], lamps=["found"], exposure=None, each=True)
            completions.complete(library, None, Path(folder) / "m.bsdf", pictures=request)
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            print(
                f"{count} pictures of 12 megapixels: {time.perf_counter() - start:.0f} s, {most:.1f} GB at most so far"
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--library", type=Path, help="needed except for --stated")
    parser.add_argument("--set", type=Path)
    parser.add_argument("--files", type=Path)
    parser.add_argument("--every", type=int, default=1)
    for name in ("--wrong", "--expected", "--together", "--cost", "--stated"):
        parser.add_argument(name, action="store_true")
    parser.add_argument("--lights", nargs="+", default=list(COUNTS), choices=COUNTS)
    parser.add_argument(
        "--keep", type=Path, help="folder of the errors of each file; those there are not measured again"
    )
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    files = sorted(asked.files.glob("*_rgb.bsdf"))[:: asked.every] if asked.files else []
    if asked.stated:
        stated(asked.set, files, asked.json)
        return
    if asked.library is None:
        parser.error("--library is needed")
    if asked.set:
        real(asked.set, asked.library)
    if files:
        rendered(files, asked.library, asked)
    if asked.cost:
        cost(asked.library)


if __name__ == "__main__":
    main()
