"""How good surfaces are: `bench_surface.py FOLDER LIBRARY`, a folder of workbooks with `Texture Images`.

Left out: each picture under a lamp is left out, the surface estimated from the others, and lit by the lamp that was
left out; its mean colour comes from the reading at that geometry, scaled as the other pictures are. Beside it one
colour, the mean of the other pictures, and albedo with a Lambertian's slope. Relative RMS, CIEDE2000 per pixel (median
of a picture; median and 90th percentile over pictures) and structural similarity.

Rendered: the completed BRDF on the slopes, times the albedo, under the instrument's lamps: its mean beside the twelve
readings, each pixel beside the real picture, and the sparkle of its flakes beside that of the pictures.

Hidden: spectra of one to five of the pictures' geometries are hidden, and the rest completed with and without the
colours of the pictures there; CIEDE2000 at the hidden spectra, median and 90th percentile.

Known: reliefs of known BRDF, slopes, colours and flakes are rendered by Mitsuba in the instrument's geometry, with
shadows and interreflections, and recovered (`tests/surface/surface_twins.py`); and how much one pixel's roughness is
determined by its pictures.

Matte: pictures from above of a Lambertian relief with slopes of 0.1, by number and angle of lamps and noise: ratio of
the slopes to the true ones, their error (RMS), and the error that is stated. `--matte` prints only these.

`--learn` fits the table of `manifold.surface.response`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from manifold.brdf.interface import EvaluableBRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import file_to_srgb, srgb_to_xyz, to_srgb
from manifold.colour.difference import delta_e_2000, delta_e_2000_lab, lab_values
from manifold.core.records import Array, Bands
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.estimate.completions import complete
from manifold.estimate.picture_colours import reading_at, with_picture_colours
from manifold.formats.registry import read_readings
from manifold.formats.workbook_pictures import picture_directions, picture_geometry
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.render.bsdf_parameters import principled
from manifold.render.fitted_brdf import FittedBRDF
from manifold.surface.estimate import Surface, estimate_surface
from manifold.surface.lamp_pictures import SurfacePictures, in_plane, read_workbook
from manifold.surface.response import Response, shaded
from manifold.surface.sparkle import Flakes, sparkle_of
from manifold.surface.tiling import tile

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "surface"))
import surface_twins as twins

D65 = np.array([0.9505, 1.0, 1.0891])


def one_colour(pictures: SurfacePictures, lamp: Array, mean: Array) -> Array:
    """The mean everywhere."""
    return np.broadcast_to(mean, pictures.values.shape[1:])


def mean_of_others(pictures: SurfacePictures, lamp: Array, mean: Array) -> Array:
    """The other pictures' mean."""
    relative = (pictures.values / pictures.values.mean(axis=(1, 2), keepdims=True)).mean(axis=0)
    return relative / relative.mean(axis=(0, 1)) * mean


def lambertian(pictures: SurfacePictures, lamp: Array, mean: Array) -> Array:
    """Albedo and one slope, `A (1 - p tan theta)`, by least squares."""
    relative = pictures.values / pictures.values.mean(axis=(1, 2), keepdims=True)
    lit = ~pictures.is_diffuse
    tangents = -pictures.lamps[lit, 1] / pictures.lamps[lit, 2]
    design = np.stack([np.ones(len(tangents)), tangents], axis=-1)
    flat = relative[lit].mean(axis=-1).reshape(len(tangents), -1)
    fitted = np.linalg.lstsq(design, flat, rcond=None)[0]
    slope = (fitted[1] / np.maximum(fitted[0], 1e-3)).reshape(relative.shape[1:3])
    albedo = relative.mean(axis=0)
    made = albedo * np.maximum(1.0 + slope * -lamp[1] / lamp[2], 0.05)[..., None]
    return made / made.mean(axis=(0, 1)) * mean


def surface(pictures: SurfacePictures, lamp: Array, mean: Array) -> Array:
    """This package's."""
    return estimate_surface(pictures).lit(lamp, mean)


METHODS: dict[str, Callable[[SurfacePictures, Array, Array], Array]] = {
    "one colour": one_colour,
    "mean of the others": mean_of_others,
    "albedo and a Lambertian's slope": lambertian,
    "surface": surface,
}


def errors(made: Array, true: Array) -> tuple[float, float, float]:
    """Relative RMS, median CIEDE2000 and structural similarity of two pictures in linear sRGB."""
    rms = float(np.sqrt(np.mean((made - true) ** 2) / np.mean(true**2)))
    return rms, float(np.median(ciede2000(made, true))), similarity(made, true)


def ciede2000(made: Array, true: Array) -> Array:
    """Differences of colours in linear sRGB, shape (...)."""
    return delta_e_2000(*(srgb_to_xyz(np.clip(colours, 0.0, None)) for colours in (made, true)), D65)


def similarity(made: Array, true: Array) -> float:
    """Mean structural similarity over channels of range 1 (Wang et al. 2004)."""

    def blurred(values: Array) -> Array:
        return gaussian_filter(values, (1.5, 1.5, 0.0), truncate=3.5)

    a, b = blurred(made), blurred(true)
    va, vb, vab = blurred(made**2) - a**2, blurred(true**2) - b**2, blurred(made * true) - a * b
    return float(np.mean((2 * a * b + 1e-4) * (2 * vab + 9e-4) / ((a**2 + b**2 + 1e-4) * (va + vb + 9e-4))))


def left_out(folder: Path) -> Iterator[tuple[str, str, str, tuple[float, float, float]]]:
    """Workbook, picture, method and errors."""
    for path in sorted(folder.glob("*.xlsx")):
        start = time.perf_counter()
        pictures, _ = read_workbook(path)
        estimate_surface(pictures)
        print(f"{path.name}: {time.perf_counter() - start:.1f} s, {'; '.join(pictures.notes)}", flush=True)
        for j in np.flatnonzero(~pictures.is_diffuse):
            others = pictures.without(int(j))
            mean = pictures.means[j] * np.nanmedian(others.factors, axis=0)
            for name, method in METHODS.items():
                made = method(others, pictures.lamps[j], mean)
                yield path.stem, pictures.labels[j], name, errors(made, pictures.values[j])


def hidden(folder: Path, library: Path) -> dict[str, Any]:
    """Differences at hidden spectra, by their number; up to six choices of each."""
    atoms, rng = LibraryAtoms.of_library(Library(library)), np.random.default_rng(0)
    apart: dict[str, dict[str, list[float]]] = {}
    for path in sorted(folder.glob("*.xlsx")):
        readings = read_readings(path)
        angles = [picture_geometry(caption) for caption in readings.texture["images"]]
        seen = [
            reading_at(readings, *picture_directions(*pair))
            for pair in angles
            if pair and np.isfinite(pair[1])
        ]
        for count in range(1, len(seen)):
            choices = list(combinations(seen, count))
            for k in rng.permutation(len(choices))[:6]:
                away = np.array(choices[k])
                rest = readings.select_pairs(np.setdiff1d(np.arange(len(readings)), away))
                for name, used in (("without", rest), ("with", with_picture_colours(rest))):
                    f = Completion.of(atoms, used).brdf.eval(readings.wi[away], readings.wo[away])
                    lab = (
                        lab_values(v, readings.bands, readings.viewing) for v in (f, readings.values[away])
                    )
                    apart.setdefault(f"{count}", {}).setdefault(name, []).extend(delta_e_2000_lab(*lab))
    found = {
        count: {name: [float(np.percentile(e, share)) for share in (50, 90)] for name, e in both.items()}
        for count, both in apart.items()
    }
    print(json.dumps(found))
    return found


def rendered(folder: Path, library: Path) -> dict[str, Any]:
    """Rendered surfaces beside readings and pictures, by workbook."""
    found = {}
    for path in sorted(folder.glob("*.xlsx")):
        pictures, readings = read_workbook(path)
        with tempfile.TemporaryDirectory() as made:
            complete(library, readings, Path(made, "mean.bsdf"))
            brdf = MeasuredBRDF(file_to_srgb(read_bsdf(Path(made, "mean.bsdf"))))
        surface = estimate_surface(pictures, brdf)
        every = slice(None, None, 3)
        slope, albedo = surface.relief[every, every], surface.albedo[every, every]
        bands = Bands.from_array(readings.wavelengths_nm)
        means = []
        for wi, wo, values in zip(readings.wi, readings.wo, readings.values, strict=True):
            # The plane of the readings is that of x, the pictures' that of y.
            lamp, camera = (np.array([0.0, -w[0], w[2]]) for w in (wo, wi))
            mean = (shaded(brdf, slope, lamp, camera) * albedo).mean(axis=(0, 1))
            means.append(float(ciede2000(mean, np.pi * to_srgb(values, bands))))
        pixels = []
        for j in np.flatnonzero(~pictures.is_diffuse):
            made = shaded(brdf, slope, pictures.lamps[j], pictures.camera) * albedo
            real = pictures.values[j, every, every] / np.nanmedian(pictures.factors, axis=0)
            pixels.append(
                float(np.median(ciede2000(made * real.mean(axis=(0, 1)) / made.mean(axis=(0, 1)), real)))
            )
        found[path.stem] = {
            "gain": surface.gain, "mean": means, "pixels": pixels, **_sparkle_again(surface, brdf, pictures),
        }  # fmt: skip
        print(path.stem, json.dumps(found[path.stem]), flush=True)
    means = np.array([row["mean"] for row in found.values()])
    return {
        "mean": [float(np.median(means)), float(np.percentile(means, 90))],
        "mean_max": float(means.max()),
        "within_1": float(np.mean(means <= 1.0)),
        "pixels": float(np.median([row["pixels"] for row in found.values()])),
        "workbooks": found,
    }


def _sparkle_again(surface: Surface, brdf: EvaluableBRDF, pictures: SurfacePictures) -> dict[str, Any]:
    """Glints of the pictures, and of the tiled texture with its flakes under the same lamps, counted alike."""
    counted = sparkle_of(surface)
    if counted.flakes is None or counted.density < 1.0:
        return {"glints": counted.density, "glints_rendered": None}
    size = 384
    textures, flakes = tile(surface, size), counted.flakes.drawn(size, np.random.default_rng(1))
    tilted = flakes.normal[..., :2] / flakes.normal[..., 2:]
    values = []
    for lamp, real in zip(pictures.lamps, pictures.values, strict=True):
        if np.isnan(lamp[0]):
            values.append(surface.mean * textures.albedo)
            continue
        made = shaded(brdf, textures.slope, lamp, pictures.camera) * textures.albedo
        half = (lamp + pictures.camera) / np.linalg.norm(lamp + pictures.camera)
        away = np.sum((tilted - half[:2] / half[2]) ** 2, axis=-1) / counted.flakes.roughness**2
        peak = counted.flakes.reflectance / (4.0 * counted.flakes.roughness**2 * lamp[2] * pictures.camera[2])
        made = made * real.mean(axis=(0, 1)) / np.nanmedian(pictures.factors, axis=0) / made.mean(axis=(0, 1))
        values.append(made + (flakes.mask * peak / (1.0 + away) ** 2)[..., None])
    again = sparkle_of(estimate_surface(replace(pictures, values=np.stack(values)), brdf))
    return {
        "glints": counted.density, "glints_rendered": again.density, "brightness": counted.brightness,
        "brightness_rendered": again.brightness, "seen_once": counted.seen_once, "seen_once_rendered": again.seen_once,
    }  # fmt: skip


def known(size: int = 192) -> dict[str, Any]:
    """Render known reliefs, estimate them, and return the errors."""
    colour = np.array([0.5, 0.3, 0.2])
    found: dict[str, Any] = {"relief": {}}
    for roughness in (0.8, 0.6, 0.4):
        for steepness in (0.07, 0.13):
            rng = np.random.default_rng(7)
            height, slope = (steepness / 0.1 * each for each in twins.truth(rng, (size, size)))
            reflectance = np.clip(colour * _textured(rng, size), 0.0, 0.95)
            pictures = twins.rendered(rng, _principled(roughness), height, reflectance)
            surface = estimate_surface(pictures, _fitted(colour, roughness))
            inner = slice(twins.BORDER, -twins.BORDER)
            slope, reflectance = slope[inner, inner], reflectance[inner, inner]
            row = {"roughness": roughness, "slope_std": steepness, "gain": surface.gain}
            for axis, name, values in ((1, "along", surface.slope), (0, "across", surface.relief)):
                row[f"{name}_correlation"] = float(
                    np.corrcoef(values[..., axis].flat, slope[..., axis].flat)[0, 1]
                )
                row[f"{name}_steepness"] = float(
                    np.polyfit(slope[..., axis].ravel(), values[..., axis].ravel(), 1)[0]
                )
            flat = estimate_surface(pictures).slope[..., 1]
            row["along_steepness_without_lobe"] = float(np.polyfit(slope[..., 1].ravel(), flat.ravel(), 1)[0])
            made, true = (each / each.mean(axis=(0, 1)) * colour for each in (surface.albedo, reflectance))
            row["albedo_ciede2000"] = float(np.median(ciede2000(made, true)))
            row["albedo_ciede2000_of_mean"] = float(
                np.median(ciede2000(np.broadcast_to(colour, true.shape), true))
            )
            found["relief"][f"roughness {roughness:g} slope {steepness:g}"] = row
            print(json.dumps(row), flush=True)
    dark, cases = 0.5 * colour, []
    for flakes in (
        Flakes(100, 2, 0.3, 0.15, 0.04), Flakes(100, 2, 0.3, 0.1, 0.04), Flakes(300, 2, 0.3, 0.1, 0.02),
        Flakes(50, 2, 0.2, 0.15, 0.04), Flakes(200, 4, 0.25, 0.1, 0.03), Flakes(100, 3, 0.5, 0.15, 0.08),
    ):  # fmt: skip
        rng = np.random.default_rng(5)
        height = 0.6 * twins.truth(rng, (320, 320))[0]
        reflectance = dark * _textured(rng, 320)
        drawn = flakes.drawn(320, rng)
        pictures = twins.rendered(rng, _principled(0.7), height, reflectance, flakes=drawn)
        again = sparkle_of(estimate_surface(pictures, _fitted(dark, 0.7))).flakes
        assert again is not None
        cases.append({"known": vars(flakes), "recovered": vars(again)})
        print(json.dumps(cases[-1]), flush=True)
    ratios = {
        name: [case["recovered"][name] / case["known"][name] for case in cases]
        for name in ("density", "slope_std", "roughness", "reflectance")
    }
    over = {name: [float(np.median(values)), max(values)] for name, values in ratios.items()}
    found["flakes"] = {"cases": cases, "recovered_over_known": over}
    found["roughness"] = _roughness_std()
    print(json.dumps(found["roughness"]))
    return found


def matte() -> dict[str, Any]:
    """Estimate matt reliefs from pictures under lamps all around, without readings, and return the errors."""
    found = {}
    for count, angle_deg, noise in (
        (8, 15, 0.0), (8, 30, 0.0), (8, 60, 0.0), (3, 30, 0.0), (8, 30, 0.01), (8, 30, 0.1), (4, 30, 0.02),
        (3, 30, 0.05), (12, 50, 0.03),
    ):  # fmt: skip
        rng = np.random.default_rng(3)
        _, slope = twins.truth(rng, (160, 160))
        colour = np.array([0.5, 0.3, 0.2]) * np.exp(0.15 * twins.rough(rng, (160, 160)))[..., None]
        pictures = twins.matte(rng, slope, twins.lamps_around(count, angle_deg), noise=noise, albedo=colour)
        made = estimate_surface(pictures)
        row = {
            "steepness": float(np.polyfit(slope.ravel(), made.slope.ravel(), 1)[0]),
            "slope_rms": float(np.sqrt(np.mean((made.slope - slope) ** 2))),
            "slope_rms_stated": float(np.sqrt(np.mean(made.slope_std**2))),
            "albedo_log_std": float(np.std(np.log(made.albedo / (colour / colour.mean(axis=(0, 1)))))),
        }
        found[f"{count} lamps at {angle_deg} degrees, noise {noise:g}"] = row
        print(count, angle_deg, noise, json.dumps(row), flush=True)
    return found


def _textured(rng: np.random.Generator, size: int) -> Array:
    shades, hues = (twins.rough(rng, (size, size))[..., None] for _ in range(2))
    return np.exp(0.15 * shades + 0.08 * hues * np.array([1.0, 0.0, -1.0]))


def _principled(roughness: float) -> Callable[[Any], dict[str, Any]]:
    return lambda texture: {"type": "principled", "base_color": texture, "roughness": roughness}


def _fitted(colour: Array, roughness: float) -> FittedBRDF:
    family = principled(("base_color", "roughness"))
    return FittedBRDF.of(family, {"base_color": colour.tolist(), "roughness": roughness}, Bands(None), {})


def _roughness_std() -> dict[str, float]:
    """Standard deviation to which one pixel's roughness is known from its pictures, by roughness.

    From the Fisher information of six pictures whose noise is that of the table, beside unknown albedo and slope.
    """
    lamps, colour = in_plane(twins.ANGLES_DEG[:6]), np.array([0.5, 0.3, 0.2])
    found = {}
    for roughness in (0.4, 0.6, 0.8):
        step = 0.05
        logs = [
            np.log([shaded(_fitted(colour, roughness + sign * step), np.zeros((1, 2)), lamp, twins.CAMERA)[0].mean()
                    for lamp in lamps])
            for sign in (-1.0, 1.0)
        ]  # fmt: skip
        response = Response.of(lamps, np.full((6, 3), 0.3))
        jacobian = np.stack([np.ones(6), response.factors[:, 1], (logs[1] - logs[0]) / (2.0 * step)], axis=-1)
        # Weights are relative to a bright channel's noise of 0.08; three channels agree.
        information = jacobian.T @ (response.weights.mean(axis=1)[:, None] * jacobian)
        found[f"{roughness:g}"] = float(np.sqrt(np.linalg.inv(information)[2, 2]))
    return found


def learn(folder: Path) -> None:
    """Print the table of responses that explains all pictures best, by alternating least squares."""
    logs, weights = [], []
    for path in sorted(folder.glob("*.xlsx")):
        pictures, _ = read_workbook(path)
        values = pictures.values[:, ::4, ::4].reshape(len(pictures.labels), -1, 3)
        logs.append(np.log(values / values.mean(axis=1, keepdims=True)))
        weights.append(1.0 / (0.08**2 + (0.012 / values.mean(axis=1)) ** 2))
        lamps = pictures.lamps
    angles = np.rad2deg(np.arctan2(-lamps[:, 1], lamps[:, 2]))
    table = np.stack(
        [np.nan_to_num(np.tan(np.deg2rad(angles))), np.nan_to_num(angles / 60.0) ** 2 - 0.3], axis=-1
    )
    prior = np.diag([1.0 / 0.126**2, 1.0 / 0.083**2])
    for _ in range(25):
        normal, right = np.zeros((len(table), 2, 2)), np.zeros((len(table), 2))
        states = []
        for log, weight in zip(logs, weights, strict=True):
            a, b = prior, 0.0
            centred = []
            for c in range(3):
                share = weight[:, c] / weight[:, c].sum()
                factor, value = table - share @ table, log[..., c] - share @ log[..., c]
                a = a + (weight[:, c, None] * factor).T @ factor
                b = b + (weight[:, c, None] * factor).T @ value
            state = np.linalg.solve(a, b)
            states.append(state)
            for c in range(3):
                share = weight[:, c] / weight[:, c].sum()
                albedo = share @ (log[..., c] - table @ state)
                centred.append(log[..., c] - albedo)
                normal += weight[:, c, None, None] * (state @ state.T)
                right += weight[:, c, None] * (centred[-1] @ state.T)
        table = np.linalg.solve(normal + 1e-6 * np.eye(2), right[..., None])[..., 0]
        covariance = np.cov(np.concatenate(states, axis=1))
        table[:, 0] += covariance[0, 1] / covariance[0, 0] * table[:, 1]  # uncorrelated states
        at = {round(angle): k for k, angle in enumerate(angles) if np.isfinite(angle)}
        table[:, 0] *= 2.0 * np.tan(np.deg2rad(30.0)) / (table[at[30], 0] - table[at[-30], 0])
        table[:, 1] *= 1.29 / np.abs(table[:, 1]).max()
    for angle, row in zip(angles, table, strict=True):
        print(f"{angle:6.0f}  slope {row[0]:6.3f}  third {row[1]:6.3f}")
    print(
        "standard deviations of the states", np.sqrt(np.diag(np.cov(np.concatenate(states, axis=1)))).round(3)
    )


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("library", type=Path, nargs="?", help="of measured materials, to complete readings")
    parser.add_argument("--learn", action="store_true")
    parser.add_argument("--matte", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.matte:
        matte()
        return
    if options.folder is None:
        parser.error("a folder of workbooks is needed")
    if options.learn:
        learn(options.folder)
        return
    summary: dict[str, Any] = {"known": known(), "matte": matte()}
    if options.library:
        summary["rendered"] = rendered(options.folder, options.library)
        summary["hidden"] = hidden(options.folder, options.library)
    rows = list(left_out(options.folder))
    print(f"{'':34}{'rel. RMS':>9}{'CIEDE2000':>16}{'SSIM':>7}   by picture")
    for name in METHODS:
        own = [(label, error) for _, label, method, error in rows if method == name]
        values = np.array([error for _, error in own])
        by_label = {label: float(np.median([e[1] for k, e in own if k == label])) for label, _ in own}
        summary[name] = {
            "relative_rms": float(np.median(values[:, 0])),
            "ciede2000": [float(np.median(values[:, 1])), float(np.percentile(values[:, 1], 90))],
            "similarity": float(np.median(values[:, 2])), "ciede2000_by_picture": by_label,
        }  # fmt: skip
        print(
            f"{name:34}{np.median(values[:, 0]):9.3f}{np.median(values[:, 1]):9.2f} / "
            f"{np.percentile(values[:, 1], 90):.2f}{np.median(values[:, 2]):7.3f}   "
            + " ".join(f"{label} {value:.2f}" for label, value in by_label.items())
        )
    if options.json:
        options.json.write_text(json.dumps(summary, indent=1) + "\n")


if __name__ == "__main__":
    main()
