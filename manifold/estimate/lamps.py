"""Lamps that light a photographed ball: discs in the camera's frame, distant or near.

The frame is that of photometric stereo: x to the right, y up, z towards the camera. Values of photographs under lamps
are relative to a white diffuser that faces the lamp at its distance. A photograph of a mirror ball in the same place
shows the surrounding light; its clipped spots are treated as lamps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.ndimage import label, map_coordinates

from manifold.brdf.interface import BRDF
from manifold.colour.lights import directions
from manifold.core import disk
from manifold.core.directions import normalize
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.names import first_few
from manifold.core.records import Array
from manifold.estimate.outlines import Circle, Photograph
from manifold.estimate.pixels import Blocks, Camera, frames, sampled_surface
from manifold.formats.text import data_lines, decode, list_rows, number, with_whole_name

LEAST_DISTANCE = 1.2
"""Smallest distance of a lamp from the centre of a ball, in radii of the ball."""
MOST_DISTANCE = 1e6
"""Largest distance of a near lamp or camera, in radii of the ball; beyond it they are treated as infinitely far."""
SAMPLES = 24
"""Number of points per block of pixels at which the light of lamps is evaluated."""

_PICTURE_SAMPLES = 4  # points of a lamp's disc
_RADIUS_DEG = 0.25  # radius of the sun, for lamps of which none is known
_IRRADIANCE = np.pi  # makes a white diffuser that faces the lamp 1
_HEIGHT = 256  # pixels of the unwrapped picture
_RIM = 0.985  # share of the radius, beyond which pixels mix the ball with what is beside it
_MOST_SPOTS = 4
_LEAST_SPOT = 0.1  # share of the largest spot's light; smaller ones stay as they are


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp: a luminous disc that faces the ball.

    Attributes:
        direction: unit vector to the centre of the disc in the camera's frame, shape (3,).
        distance: distance from the centre of the ball, in radii of the ball.
        colour: relative colour of the light in the channels of the camera, shape (3,).
        radius_deg: angular radius of the disc, seen from the ball.
        known: what a file states about `colour`: nothing, its strength, or all three channels.
    """

    direction: Array
    distance: float = np.inf
    colour: Array = field(default_factory=lambda: np.ones(3))
    radius_deg: float = _RADIUS_DEG
    known: Literal["", "strength", "colour"] = ""

    def __str__(self) -> str:
        at = ",".join(f"{v:.3f}" for v in self.direction)
        return at if np.isinf(self.distance) else f"{at},{self.distance:.3g}"

    def degrees_from(self, other: Lamp) -> float:
        """Return the angle between the directions of two lamps."""
        return float(np.rad2deg(np.arccos(np.clip(self.direction @ other.direction, -1.0, 1.0))))

    @classmethod
    def towards(cls, vector: Array, distance: float = np.inf) -> Lamp:
        """Return a lamp in a direction (3,) of any length."""
        vector = np.asarray(vector, dtype=np.float64)
        length = float(np.linalg.norm(vector))
        if not (np.isfinite(length) and length > 0.0):
            raise UsageError(f"a lamp at {','.join(f'{v:g}' for v in vector)}, expected a direction")
        if not (LEAST_DISTANCE <= distance <= MOST_DISTANCE or np.isinf(distance)):
            raise UsageError(
                f"a lamp at {distance:g} radii of the ball, expected {LEAST_DISTANCE} to {MOST_DISTANCE:g}, or none"
            )
        return cls(vector / length, distance)

    def of_intensity(self, values: Array) -> Lamp:
        """Return the lamp with an intensity in one or three channels, (1,) or (3,); with (0,), the same lamp."""
        if not len(values):
            return self
        return replace(
            self,
            colour=np.broadcast_to(values, (3,)).copy(),
            known="colour" if len(values) == 3 else "strength",
        )


def parse_lamp(text: str, pictures: Sequence[str] = ()) -> list[Lamp]:
    """Parse lamps from `X,Y,Z`, `X,Y,Z,DISTANCE`, `flash`, or the path of a file, see `read_lamps`."""
    if text == "flash":
        return [Lamp(np.array([0.0, 0.0, 1.0]))]
    numbers = [number(cell) for cell in text.split(",")]
    if Path(text).is_file() or not any(value is not None for value in numbers):
        return read_lamps(Path(text), pictures, "name a text of lines X Y Z, or give X,Y,Z, flash or found")
    if len(numbers) not in (3, 4) or None in numbers:
        raise UsageError(
            f"lamp '{text}', expected X,Y,Z to the right, up and towards the camera, with a distance in radii "
            "of the ball if it is near, such as 0.5,0.5,1 or 0,1,1,8; or a file of such lines, flash, or "
            "found"
        )
    x, y, z, *distance = (value for value in numbers if value is not None)
    return [Lamp.towards(np.array([x, y, z]), distance[0] if distance else np.inf)]


_EXPECTED = "expected X Y Z, and one intensity or three, with the picture's name before them if it has one"
_AXES, _INTENSITIES = ("x", "y", "z"), ("r", "g", "b")
_OF_PICTURE = ("name", "file", "filename", "picture", "image")
# Files of data sets laid out as DiLiGenT.
_OF_DIRECTIONS, _OF_INTENSITIES, _OF_NAMES = "light_directions.txt", "light_intensities.txt", "filenames.txt"


def intensities_beside(path: Path) -> Path | None:
    """Return the file of intensities that belongs to a file of directions in data sets like DiLiGenT.

    Source: Shi et al. 2016, "A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated Photometric
    Stereo".
    """
    beside = path.with_name(_OF_INTENSITIES)
    return beside if path.name == _OF_DIRECTIONS and beside.is_file() else None


def intensity_notes(path: Path) -> tuple[str, ...]:
    """Return a note if the lamps of a file have the intensities of another file, see `intensities_beside`."""
    beside = intensities_beside(path)
    return () if beside is None else (f"intensities of the lamps from {beside.name}",)


def require_in_front(lamps: Sequence[Lamp], pictures: Sequence[str], least: float, of: str) -> None:
    """Raise UsageError for lamps with a z component below `least`; `of` names the lit object in the message."""
    names = [
        f"{name} ({lamp})" for name, lamp in zip(pictures, lamps, strict=True) if lamp.direction[2] < least
    ]
    if names:
        raise UsageError(
            f"{first_few(names)}: the lamp is behind {of}, expected z above 0: x to the right, y up, z towards the "
            "camera; correct the direction, or leave the picture out"
        )


def read_lamps(
    path: Path, pictures: Sequence[str] = (), advice: str = "name a text of lines X Y Z"
) -> list[Lamp]:
    """Read the lamps of a text file with lines `[picture] X Y Z [intensity]`, the intensity in one or three channels.

    As in photometric-stereo data sets and RTI's `.lp` files, the first line may hold the number of lamps, and lines
    may begin with their number. A header may order the columns (`picture`, `x`, `y`, `z`, `intensity`, or `r`, `g`,
    `b`). If the file names pictures, the lamps are returned in the order of `pictures`, a list of file names.
    `light_directions.txt` is read with `light_intensities.txt` and `filenames.txt` in the same folder.

    Raises:
        MissingFileError: there is no such file; `advice` ends the message.
        FileFormatError: a line is not a lamp, the names are not those of the pictures, or the numbers of lines differ.
    """
    lamps, is_named = _lamps_in(path, pictures, advice)
    if (beside := intensities_beside(path)) is not None and not any(lamp.known for lamp in lamps.values()):
        rows = _intensities(beside, len(lamps))
        lamps = {name: lamp.of_intensity(row) for (name, lamp), row in zip(lamps.items(), rows, strict=True)}
    names = path.with_name(_OF_NAMES)
    if path.name == _OF_DIRECTIONS and names.is_file() and not is_named:
        listed = [_picture_name(line) for _, line in _lines(names, advice)]
        if len(set(listed)) != len(lamps):
            raise FileFormatError(
                f"{names}: found {len(set(listed))} names, expected {len(lamps)}, one for each lamp"
            )
        lamps, is_named = dict(zip(listed, lamps.values(), strict=True)), True
    return _in_order(path, lamps, pictures) if is_named and pictures else list(lamps.values())


def _lines(path: Path, advice: str) -> list[tuple[int, str]]:
    text = decode(disk.read_bytes(path, advice=advice, most=disk.MOST_TEXT))
    return data_lines(text.split("\n"), marks=("#",))


def _intensities(path: Path, count: int) -> list[Array]:
    """Read one or three intensities per line, for `count` lamps."""
    rows = list_rows(_lines(path, "name a text of intensities"))
    if len(rows) != count:
        raise FileFormatError(f"{path}: found {len(rows)} lines, expected {count}, one for each direction")
    found: list[Array] = []
    for n, cells in rows:
        values = [number(cell) for cell in cells]
        if len(values) not in (1, 3) or not all(value is not None and value > 0.0 for value in values):
            raise FileFormatError(
                f"{path}, line {n}: found '{' '.join(cells)[:40]}', expected one intensity above 0, or three (R G B)"
            )
        found.append(np.array(values, dtype=np.float64))
    return found


def _lamps_in(path: Path, pictures: Sequence[str], advice: str) -> tuple[dict[str, Lamp], bool]:
    """Read the lamps of one file by the names of their pictures or, if it names none, by the numbers of their lines."""
    lines = _lines(path, advice)
    if lines and (count := number(lines[0][1])) is not None:
        lines = lines[1:]
        if count != len(lines):
            raise FileFormatError(
                f"{path}: found {len(lines)} lamps, expected {count:g}, as the first line says"
            )
    rows = list_rows(lines)
    head = None
    if rows and not any(number(cell) is not None for cell in rows[0][1]):
        head = _lamp_columns(path, rows.pop(0)[1])
    elif _name_pictures([cells for _, cells in rows], pictures):
        head = 0, [*range(1, len(rows[0][1]))]
    if not rows:
        raise FileFormatError(f"{path}: no lamps, {_EXPECTED}")
    if head is None and _are_counted([cells for _, cells in rows]):
        rows = [(n, cells[1:]) for n, cells in rows]
    lamps: dict[str, Lamp] = {}
    for n, cells in rows:
        name, numbers = _lamp_cells(cells, head)
        if None in numbers or len(numbers) not in (3, 4, 6):
            raise FileFormatError(f"{path}, line {n}: found '{' '.join(cells)[:40]}', {_EXPECTED}")
        values = np.array(numbers, dtype=np.float64)
        if not np.all(values[3:] > 0.0):
            raise FileFormatError(f"{path}, line {n}: an intensity that is not above 0")
        key = _picture_name(name) or str(n)
        if key in lamps:
            raise FileFormatError(f"{path}, line {n}: the picture {key} occurs twice, expected each once")
        try:
            lamps[key] = Lamp.towards(values[:3]).of_intensity(values[3:])
        except UsageError as error:
            raise FileFormatError(f"{path}, line {n}: {error}") from None
    return lamps, any(_lamp_cells(cells, head)[0] for _, cells in rows)


def _name_pictures(rows: list[list[str]], pictures: Sequence[str]) -> bool:
    """Return whether rows begin with the names of the pictures, which are numbers, in front of X, Y and Z."""
    first = {cells[0] for cells in rows}
    names = {Path(name).stem for name in pictures}
    return bool(names) and names <= first and len(first) == len(rows) and min(map(len, rows)) > 3


def _are_counted(rows: list[list[str]]) -> bool:
    """Return whether rows begin with their numbers, from 0 or 1, in front of X, Y and Z."""
    first = [number(cells[0]) for cells in rows]
    is_counted = first in ([*range(len(rows))], [*range(1, len(rows) + 1)])
    return is_counted and len(rows) > 2 and all(len(cells) > 3 for cells in rows)


def _lamp_columns(path: Path, heads: list[str]) -> tuple[int | None, list[int]]:
    """Return a header's column of pictures' names (None without one) and its columns of X, Y, Z and intensities."""
    words = [head.strip().lower() for head in heads]
    numbers = [*_AXES, *(_INTENSITIES if "r" in words else [w for w in ("intensity",) if w in words])]
    unknown = set(words) - set(numbers) - set(_OF_PICTURE)
    if not set(numbers) <= set(words) or unknown or len(set(words)) < len(words):
        raise FileFormatError(f"{path}: found the header {', '.join(heads)[:60]}, {_EXPECTED}")
    name = next((words.index(word) for word in _OF_PICTURE if word in words), None)
    return name, [words.index(word) for word in numbers]


def _lamp_cells(
    cells: list[str], head: tuple[int | None, list[int]] | None
) -> tuple[str, list[float | None]]:
    """Return the picture's name, empty if there is none, and the numbers of a line."""
    if head is None:
        cells = with_whole_name(cells, 4) if number(cells[0]) is None else ["", *cells]
        return cells[0], [number(cell) for cell in cells[1:]]
    name, columns = head
    cells = with_whole_name(cells, len(columns) + (name is not None))
    if len(cells) != len(columns) + (name is not None):
        return "", [None]
    return "" if name is None else cells[name], [number(cells[k]) for k in columns]


def _picture_name(text: str) -> str:
    """Return the name of a file at the end of a path of any system."""
    return text.replace("\\", "/").rpartition("/")[2].strip()


def _in_order(path: Path, lamps: Mapping[str, Lamp], pictures: Sequence[str]) -> list[Lamp]:
    """Return the lamps of pictures; names may differ in case, and in the suffix if that is unambiguous."""
    by_stem = {Path(name).stem.casefold(): lamp for name, lamp in lamps.items()}
    missing = [name for name in pictures if Path(name).stem.casefold() not in by_stem]
    if missing or len(by_stem) < len(lamps):
        raise FileFormatError(
            f"{path}: no lamp of the picture {missing[0] if missing else pictures[0]}, found those of "
            f"{first_few(list(lamps))}; name the pictures as their files are"
        )
    return [by_stem[Path(name).stem.casefold()] for name in pictures]


def lamp_pairs(blocks: Blocks, camera: Camera, lamps: Sequence[Lamp]) -> tuple[Array, Array, Array]:
    """Return the direction pairs of each block, and the light of each pair, as `pixels.direction_pairs` does.

    A block's value is the mean over `SAMPLES` of its points; each point is lit by one point of every lamp's disc.
    """
    normal, view, u = sampled_surface(blocks, camera, SAMPLES)
    frame = frames(normal)
    wi = np.einsum("ksij,ksj->ksi", frame, view)
    parts = [lit(normal, frame, camera, lamp, u[..., 1:3]) for lamp in lamps]
    wo = np.concatenate([part[0] for part in parts], axis=1)
    light = np.concatenate([part[1] for part in parts], axis=1) / SAMPLES
    return np.tile(wi, (1, len(lamps), 1)), wo, light


def lit(normal: Array, frame: Array, camera: Camera, lamp: Lamp, u: Array) -> tuple[Array, Array]:
    """Return the directions (..., 3) to points of a lamp's disc, in frames of the surface, and the irradiance (..., 3).

    `normal` (..., 3) and `frame` (..., 3, 3) are in the world, the lamp in the camera's frame; the variates u (...,
    2) in [0, 1) select points of the disc.
    """
    axis = lamp.direction @ np.array(camera.axes)
    towards = np.broadcast_to(axis, normal.shape)
    falloff: Array | float = 1.0
    if np.isfinite(lamp.distance):
        away = lamp.distance * axis - normal
        length = np.linalg.norm(away, axis=-1, keepdims=True)
        towards, falloff = away / length, (lamp.distance / length[..., 0]) ** 2
    radius = np.tan(np.deg2rad(lamp.radius_deg)) * np.sqrt(u[..., :1])
    angle = 2.0 * np.pi * u[..., 1:]
    across = frames(towards)
    towards = normalize(
        towards + radius * (np.cos(angle) * across[..., 0, :] + np.sin(angle) * across[..., 1, :])
    )
    wo = np.einsum("...ij,...j->...i", frame, towards)
    is_lit = wo[..., 2] > 1e-6
    power = np.where(is_lit, _IRRADIANCE * wo[..., 2] * falloff, 0.0)
    return np.where(is_lit[..., None], wo, [0.0, 0.0, 1.0]), power[..., None] * lamp.colour


def lamp_picture(brdf: BRDF, camera: Camera, lamps: Sequence[Lamp], size: int, margin: float) -> Array:
    """Render a ball on black under lamps, whose colours are ignored; return an image (size, size, B).

    `margin` is the margin around the ball in radii.
    """
    across = (1.0 + margin) * (2.0 * (np.arange(size) + 0.5) / size - 1.0)
    x, y = np.meshgrid(across, -across)
    inside = np.hypot(x, y) < 1.0
    normal, view = camera.surface(x[inside], y[inside])
    frame = frames(normal)
    wi = np.einsum("kij,kj->ki", frame, view)
    picture = np.zeros((size, size, brdf.bands.count))
    u = np.random.default_rng(0).random((_PICTURE_SAMPLES, len(normal), 2))
    for lamp in lamps:
        for part in u:
            wo, light = lit(normal, frame, camera, lamp, part)
            values = np.maximum(brdf.eval(wi, wo), 0.0) * light.mean(axis=1, keepdims=True)
            picture[inside] += values / len(u)
    return picture


def unwrapped(photograph: Photograph, circle: Circle, camera: Camera) -> Array:
    """Return the environment that a mirror ball shows a distant camera, as a latitude-longitude image (H, 2 H, 3).

    Directions behind the ball are filled from its rim; other directions that the photograph does not show are black.
    """
    world = directions(_HEIGHT)[..., [1, 0, 2]]  # from straight ahead to the right
    seen = world @ np.array(camera.axes).T  # in the camera's frame
    half = seen + np.array([0.0, 0.0, 1.0])
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
    across = half[..., :2]
    radius = np.linalg.norm(across, axis=-1, keepdims=True)
    across = across * np.minimum(1.0, _RIM / np.maximum(radius, 1e-9))
    rows = circle.y - across[..., 1] * circle.radius - 0.5
    columns = circle.x + across[..., 0] * circle.radius - 0.5
    values = np.nan_to_num(photograph.values)
    return np.stack(
        [map_coordinates(values[..., c], [rows, columns], order=1, mode="nearest") for c in range(3)], axis=-1
    )


def clipped_spots(photograph: Photograph, circle: Circle) -> tuple[Lamp, ...]:
    """Return lamps for the clipped spots in a photograph of a mirror ball, largest first.

    Their `colour`, relative to a white diffuser that faces them, is that of the clipped values, a lower bound.
    """
    clipped = photograph.is_clipped.any(axis=2)
    rows, columns = np.indices(clipped.shape) + 0.5
    x, y = (columns - circle.x) / circle.radius, (circle.y - rows) / circle.radius
    marked, count = label(clipped & (np.hypot(x, y) < _RIM))
    lamps = []
    for k in range(1, count + 1):
        own = marked == k
        z = np.sqrt(np.maximum(1.0 - x[own] ** 2 - y[own] ** 2, 0.0))
        normal = np.stack([x[own], y[own], z], axis=1)
        towards = 2.0 * z[:, None] * normal - [0.0, 0.0, 1.0]
        # A pixel shows 4 times its area over the square of the radius, wherever on the ball it is.
        solid_angle = 4.0 * len(z) / circle.radius**2
        strength = solid_angle / np.pi * np.nan_to_num(photograph.values[own]).mean(axis=0)
        radius_deg = float(np.rad2deg(np.sqrt(solid_angle / np.pi)))
        lamp = Lamp.towards(towards.mean(axis=0))
        lamps.append(Lamp(lamp.direction, np.inf, strength, min(radius_deg, 30.0)))
    lamps.sort(key=lambda lamp: -float(lamp.colour.mean()))
    return tuple(
        one for one in lamps[:_MOST_SPOTS] if one.colour.mean() >= _LEAST_SPOT * lamps[0].colour.mean()
    )
