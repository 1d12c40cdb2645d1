"""Reads a surface that `manifold surface` wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import decode_srgb
from manifold.core import disk
from manifold.core.directions import normalize
from manifold.core.errors import FileFormatError, MissingFileError, UsageError
from manifold.core.names import printable
from manifold.core.records import Array
from manifold.io_rgl import read_bsdf
from manifold.render.images import read_display, read_image
from manifold.surface.sparkle import DrawnFlakes, Flakes
from manifold.surface.tiling import Textures

_NEEDED = ("mean", "albedo", "normal", "height")
_ADVICE = "run manifold surface again"
_LEAST_MEAN = 1e-6  # of a channel: albedos relative to it stay finite
_MOST_BALL = 1000.0  # CIEDE2000
_FLAKES = {
    "density": (0.0, 1e4), "size_px": (0.0, 1e4), "slope_std": (0.0, 10.0), "roughness": (1e-6, 1.0),
    "reflectance": (1e-6, 1.0),
}  # fmt: skip
_LEAST_UP = 0.05  # z component of a normal: slopes stay finite whatever a picture holds


@dataclass(frozen=True, eq=False)
class WrittenSurface:
    """A surface that was read from its files.

    Attributes:
        name: name of the specimen.
        brdf: the mean BRDF.
        textures: the written textures: 8 bits, with colours clipped at white.
        flakes: the drawn flakes, or None.
        expected_ball: expected ball error of the mean BRDF, CIEDE2000; None if unknown.
    """

    name: str
    brdf: MeasuredBRDF
    textures: Textures
    flakes: DrawnFlakes | None
    expected_ball: float | None


def read_surface(path: Path | str) -> WrittenSurface:
    """Read a surface that `manifold surface` wrote.

    Args:
        path: the folder, or `NAME.json` if the folder has several surfaces.

    Raises:
        FileFormatError: the files are not a surface of this program, or have no mean BRDF.
        MissingFileError: a file is missing, or the folder has no surface.
        UsageError: the folder has several surfaces.
    """
    path = Path(path)
    document = path
    if path.is_dir():  # the JSON beside the only BRDF of a mean
        there = [mean.with_suffix(".json") for mean in sorted(path.glob("*.bsdf"))]
        if not there:
            raise MissingFileError(f"{path}: no surface in this folder; run `manifold surface` on a workbook")
        if len(there) > 1:
            raise UsageError(f"{path}: {len(there)} surfaces; name the JSON of one, such as {there[0].name}")
        document = there[0]
    content = disk.read_json(document, "the JSON of a surface")
    try:
        files = {kind: document.parent / Path(name).name for kind, name in content["files"].items()}
        mean = np.array([_number(value, _LEAST_MEAN, 1.0) for value in content["mean_srgb_linear"]]).reshape(
            3
        )
        completion, name = content["completion"], content["sample"]
        expected = None if completion is None else (completion["expected"] or {}).get("ball")
        expected = None if expected is None else _number(expected, 0.0, _MOST_BALL)
        drawn = _flakes(content["sparkle"]["flakes"]) if "flakes" in files else None
        if not isinstance(name, str):
            raise TypeError(f"sample {name!r}")
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        reason = printable(repr(error), 120)
        raise FileFormatError(
            f"{document}: not a JSON file of `manifold surface` ({reason}); {_ADVICE}"
        ) from None
    if missing := [kind for kind in _NEEDED if kind not in files]:
        raise FileFormatError(
            f"{document}: names no {missing[0]} file; {_ADVICE}, on a workbook with readings"
        )
    pictures = {kind: read_display(files[kind]) for kind in ("albedo", "normal")}
    pictures["height"] = read_image(files["height"])
    if drawn is not None:
        pictures |= {kind: read_display(files[kind]) for kind in ("flakes", "flake_weights")}
    if odd := [kind for kind, values in pictures.items() if values.shape != pictures["albedo"].shape]:
        raise FileFormatError(f"{files[odd[0]]}: differs in size from {files['albedo'].name}; {_ADVICE}")
    normal = _normals(pictures["normal"])
    textures = Textures(
        decode_srgb(pictures["albedo"]) / mean, normal[..., :2] / normal[..., 2:], pictures["height"][..., 0]
    )
    flakes = None
    if drawn is not None:
        mask = pictures["flake_weights"][..., 0] > 0.0
        upwards = np.array([0.0, 0.0, 1.0])
        flakes = DrawnFlakes(drawn, np.where(mask[..., None], _normals(pictures["flakes"]), upwards), mask)
    return WrittenSurface(name, MeasuredBRDF(read_bsdf(files["mean"])), textures, flakes, expected)


def _flakes(content: Any) -> Flakes:
    """Return flakes from the entry of a JSON document; KeyError, TypeError or ValueError for any other."""
    return Flakes(**{name: _number(content[name], *limits) for name, limits in _FLAKES.items()})


def _number(value: Any, least: float, most: float) -> float:
    """Return a number of a JSON document within limits; TypeError or ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    if not least <= value <= most:
        raise ValueError(f"{printable(repr(value), 24)} is not within {least:g} and {most:g}")
    return float(value)


def _normals(display: Array) -> Array:
    """Return unit normals from a picture of them, shape (S, S, 3)."""
    normal = 2.0 * display - 1.0
    return normalize(np.concatenate([normal[..., :2], np.maximum(normal[..., 2:], _LEAST_UP)], axis=-1))
