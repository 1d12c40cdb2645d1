"""Pictures of a surface predicted from the others: `bench_surface.py FOLDER` of workbooks with `Texture Images`.

Each picture under a lamp is left out, the surface estimated from the others, and lit by the lamp that was left out; its
mean colour comes from the reading at that geometry, scaled as the other pictures are. Beside it one colour, the mean of
the other pictures, and albedo with a Lambertian's slope. Relative RMS, CIEDE2000 per pixel (median of a picture; median
and 90th percentile over pictures) and structural similarity. `--learn` fits the table of `manifold.surface.response`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.records import Array
from manifold.surface.estimate import estimate_surface
from manifold.surface.lamp_pictures import SurfacePictures, read_workbook

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
    colours = [srgb_to_xyz(np.clip(picture, 0.0, None)) for picture in (made, true)]
    return rms, float(np.median(delta_e_2000(*colours, D65))), similarity(made, true)


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
    parser.add_argument("folder", type=Path)
    parser.add_argument("--learn", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.learn:
        learn(options.folder)
        return
    rows = list(left_out(options.folder))
    summary = {}
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
