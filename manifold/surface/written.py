"""A surface as `manifold surface` has written it, read again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manifold import disk
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import decode_srgb
from manifold.directions import normalize
from manifold.errors import FileFormatError, MissingFileError, UsageError
from manifold.io_rgl import read_bsdf
from manifold.records import Array
from manifold.render.images import read_display, read_image
from manifold.surface.sparkle import DrawnFlakes, Flakes
from manifold.surface.tiling import Textures

_NEEDED = ("mean", "albedo", "normal", "height")
_ADVICE = "run manifold surface again"
_LEAST_UP = 0.05  # z component of a normal: slopes stay finite whatever a picture holds


@dataclass(frozen=True, eq=False)
class WrittenSurface:
    """A surface in files.

    Attributes:
        name: of the sample.
        brdf: of the mean.
        textures: as they were written: in 8 bits, colours cut where they are brighter than white.
        flakes: those that were drawn; None where there are none.
        expected_ball: expected error of the ball of the mean, CIEDE2000; None where it is not known.
    """

    name: str
    brdf: MeasuredBRDF
    textures: Textures
    flakes: DrawnFlakes | None
    expected_ball: float | None


def read_surface(path: Path | str) -> WrittenSurface:
    """Read a surface that `manifold surface` wrote.

    Args:
        path: its folder, or its `NAME.json` where the folder has several.
    Raises:
        FileFormatError: it is no such surface, or has no BRDF of the mean.
        MissingFileError: one of its files is missing, or the folder has no surface.
        UsageError: the folder has several.
    """
    path = Path(path)
    document = _document_in(path) if path.is_dir() else path
    content = disk.read_json(document, "the JSON of a surface")
    try:
        files = {kind: document.parent / Path(name).name for kind, name in content["files"].items()}
        mean = np.array(content["mean_srgb_linear"], dtype=np.float64).reshape(3)
        flakes = content["sparkle"]["flakes"]
        completion, name = content["completion"], str(content["sample"])
        expected = None if completion is None else (completion["expected"] or {}).get("ball")
        drawn = Flakes(**flakes) if "flakes" in files else None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"{document}: is not the JSON of a surface ({error!r}); {_ADVICE}") from None
    if missing := [kind for kind in _NEEDED if kind not in files]:
        raise FileFormatError(
            f"{document}: no file of its {missing[0]}; {_ADVICE}, of a workbook with readings"
        )
    normal = _normals(files["normal"])
    textures = Textures(
        decode_srgb(read_display(files["albedo"])) / mean,
        normal[..., :2] / normal[..., 2:],
        read_image(files["height"])[..., 0],
    )
    if drawn is None:
        flakes = None
    else:
        mask = read_display(files["flake_weights"])[..., 0] > 0.0
        upwards = np.array([0.0, 0.0, 1.0])
        flakes = DrawnFlakes(drawn, np.where(mask[..., None], _normals(files["flakes"]), upwards), mask)
    return WrittenSurface(name, MeasuredBRDF(read_bsdf(files["mean"])), textures, flakes, expected)


def _document_in(folder: Path) -> Path:
    """The JSON beside the only BRDF of a mean in a folder."""
    found = [path.with_suffix(".json") for path in sorted(folder.glob("*.bsdf"))]
    if not found:
        raise MissingFileError(f"{folder}: no surface; run manifold surface of a workbook")
    if len(found) > 1:
        raise UsageError(f"{folder}: {len(found)} surfaces; name the JSON of one, such as {found[0].name}")
    return found[0]


def _normals(path: Path) -> Array:
    """Unit normals of a picture of them, shape (S, S, 3)."""
    normal = 2.0 * read_display(path) - 1.0
    return normalize(np.concatenate([normal[..., :2], np.maximum(normal[..., 2:], _LEAST_UP)], axis=-1))
