"""Pictures of one spot of a surface from one camera, each under one lamp of known direction or in diffuse light."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from manifold.colour.conversion import to_srgb
from manifold.colour.pictures import SUFFIXES, read_picture
from manifold.directions import from_spherical
from manifold.errors import FileFormatError, UsageError
from manifold.estimate.lamps import read_lamps
from manifold.formats.readings import Readings
from manifold.records import Array, Bands, Mask

DIFFUSE = "d"
"""What a picture in diffuse light is called after its anchor: `15d`."""

_LEAST_LAMPS = 3
_LEAST_SIZE = 32  # pixels a side
_DETAIL_PX = 3.0  # what is finer registers the colours
_MOST_SHIFT_PX = 2.0
_SHIFT_STEP_PX = 0.05
_LEAST_CORRELATION = 0.3  # of fine detail between two channels, to register them
_MOST_FACTOR = 1.5  # between a picture's mean and its reading, relative to the other pictures
_HALF_CODE = 0.5 / 255.0
_GEOMETRY = re.compile(r"r?_?(\d+)(?:d|_?as(-?\d+))", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class SurfacePictures:
    """Pictures of one spot; J of them, H rows, W columns.

    Columns point along x, rows against y, both in the plane of the sample; z is its normal.

    Attributes:
        name: of the sample.
        values: linear sRGB, shape (J, H, W, 3), above 0; channels registered to each other.
        lamps: unit vectors towards the lamps, shape (J, 3); NaN for diffuse light.
        camera: unit vector towards the camera, shape (3,).
        labels: J names of the pictures, as their source has them.
        means: mean linear sRGB that readings give for each picture, a white diffuser being 1, shape (J, 3); NaN where
            there is no reading.
        notes: what was assumed, in sentences.
    """

    name: str
    values: Array
    lamps: Array
    camera: Array
    labels: tuple[str, ...]
    means: Array
    notes: tuple[str, ...] = ()

    @property
    def is_diffuse(self) -> Mask:
        """Pictures in diffuse light, shape (J,)."""
        return np.isnan(self.lamps[:, 0])

    def without(self, picture: int) -> SurfacePictures:
        """All pictures but one."""
        kept = [j for j in range(len(self.labels)) if j != picture]
        return replace(
            self, values=self.values[kept], lamps=self.lamps[kept], labels=tuple(self.labels[j] for j in kept),
            means=self.means[kept],
        )  # fmt: skip

    @property
    def factors(self) -> Array:
        """Of each picture's mean over that of its reading, shape (J, 3); NaN where there is no reading."""
        return np.asarray(self.values.mean(axis=(1, 2)) / self.means)


def read_workbook(path: Path, sample: str | None = None) -> tuple[SurfacePictures, Readings]:
    """The pictures of a multi-angle spectrophotometer's workbook, and its readings.

    Args:
        path: `.xlsx` with a sheet `Texture Images`.
        sample: which of several.
    Raises:
        FileFormatError: it has fewer than three pictures under lamps, their sizes differ, or their means do not belong
            to the readings at the same geometries.
    """
    from manifold.formats.registry import read_readings

    readings = read_readings(path, sample)
    images: Mapping[str, bytes] = readings.texture.get("images", {})
    found = {caption: _geometry(caption) for caption in images}
    captions = [caption for caption, geometry in found.items() if geometry is not None]
    if sum(not np.isnan(found[c][1]) for c in captions) < _LEAST_LAMPS:  # type: ignore[index]
        raise FileFormatError(
            f"{path}: found {len(captions)} pictures with a geometry, expected at least {_LEAST_LAMPS} under lamps in "
            "a sheet 'Texture Images'; export the workbook with its pictures"
        )
    values = _stack(path, [(c, _decoded(path, c, images[c])) for c in captions])
    angles = np.array([found[c][1] for c in captions])  # type: ignore[index]
    lamps = in_plane(angles)
    camera = -np.deg2rad(found[captions[0]][0])  # type: ignore[index]
    means = np.array([_mean_of_reading(readings, camera, angle) for angle in np.deg2rad(angles)])
    values, registered = _registered(values)
    pictures = SurfacePictures(
        readings.name, values, lamps, in_plane(np.rad2deg(camera)), tuple(captions), means, registered
    )
    _require_belonging(path, pictures)
    return pictures, readings


def read_folder(pictures: Sequence[Path], lamps: Path) -> SurfacePictures:
    """Pictures of a flat sample seen from above.

    Args:
        pictures: one file a lamp, in the order of the lamps.
        lamps: text of directions as of `estimate.lamps.read_lamps`; x points right in the pictures, y up, z towards the
            camera.
    Raises:
        UsageError: there is another number of lamps, or one does not stand above the sample.
        FileFormatError: a line is no direction, or the sizes of the pictures differ.
    """
    found = read_lamps(lamps)
    if len(found) != len(pictures) or len(found) < _LEAST_LAMPS:
        raise UsageError(
            f"{lamps}: found {len(found)} lamps for {len(pictures)} pictures, expected one a picture, of "
            f"{_LEAST_LAMPS} or more"
        )
    directions = np.array([lamp.direction for lamp in found])
    if np.any(directions[:, 2] <= 0.0):
        raise UsageError(f"{lamps}: a lamp does not stand above the sample, expected z above 0")
    read = [
        (path.name, np.asarray(read_picture(path).values, dtype=np.float64) / lamp.colour)
        for path, lamp in zip(pictures, found, strict=True)
    ]
    values = np.maximum(_stack(lamps, read), _HALF_CODE)
    return SurfacePictures(
        pictures[0].parent.resolve().name, values, directions, np.array([0.0, 0.0, 1.0]),
        tuple(path.name for path in pictures), np.full((len(found), 3), np.nan),
        ("no readings: colours are relative to the brightest mean, slopes as steep as a Lambertian's would be",),
    )  # fmt: skip


def files_in(sources: Sequence[Path]) -> list[Path]:
    """Files, and those of folders that are pictures by their names, in the order of these."""
    found = []
    for source in sources:
        if source.is_dir():
            found += sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
        else:
            found.append(source)
    return found


def _geometry(caption: str) -> tuple[float, float] | None:
    """Anchor and lamp angle in degrees, the lamp's positive on the mirror's side; NaN for diffuse light."""
    found = _GEOMETRY.fullmatch(caption.strip())
    if found is None:
        return None
    anchor = float(found[1])
    return anchor, np.nan if found[2] is None else anchor - float(found[2])


def in_plane(angles_deg: Array | float) -> Array:
    """Directions in the instrument's plane, which is vertical in its pictures; positive angles towards larger rows."""
    angles = np.deg2rad(angles_deg)
    return np.stack([0.0 * angles, -np.sin(angles), np.cos(angles)], axis=-1)


def _decoded(path: Path, caption: str, content: bytes) -> Array:
    """Linear values of one picture of a workbook, which are stored as they are: the camera's codes are linear."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content), formats=("PNG", "JPEG")) as image:
            return np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FileFormatError(
            f"{path}: the picture {caption} cannot be decoded ({str(error)[:80]}); export the workbook again"
        ) from None


def _stack(path: Path, pictures: Sequence[tuple[str, Array]]) -> Array:
    shapes = {values.shape for _, values in pictures}
    if len(shapes) != 1 or min(next(iter(shapes))[:2]) < _LEAST_SIZE:
        sizes = ", ".join(sorted(f"{s[1]} x {s[0]}" for s in shapes))
        raise FileFormatError(
            f"{path}: found pictures of {sizes} pixels, expected one size of at least {_LEAST_SIZE} x {_LEAST_SIZE}"
        )
    return np.stack([values for _, values in pictures])


def _mean_of_reading(readings: Readings, camera_rad: float, lamp_rad: float) -> Array:
    """Linear sRGB of the reading at a lamp, a white diffuser being 1; NaN where there is none."""
    if np.isnan(lamp_rad):
        return np.full(3, np.nan)
    camera, lamp = (_leg(angle) for angle in (camera_rad, lamp_rad))
    wi, wo = readings.wi, readings.wo
    apart = np.minimum(
        np.linalg.norm(wi - camera, axis=-1) + np.linalg.norm(wo - lamp, axis=-1),
        np.linalg.norm(wi - lamp, axis=-1) + np.linalg.norm(wo - camera, axis=-1),
    )
    mirrored = np.array([-1.0, 1.0, 1.0])  # the other side of the plane
    apart = np.minimum(
        apart,
        np.minimum(
            np.linalg.norm(wi - mirrored * camera, axis=-1) + np.linalg.norm(wo - mirrored * lamp, axis=-1),
            np.linalg.norm(wi - mirrored * lamp, axis=-1) + np.linalg.norm(wo - mirrored * camera, axis=-1),
        ),
    )
    nearest = int(np.argmin(apart))
    if apart[nearest] > np.deg2rad(1.0):
        return np.full(3, np.nan)
    bands = Bands.from_array(readings.wavelengths_nm)
    return np.asarray(np.pi * to_srgb(readings.values[nearest], bands))


def _leg(angle_rad: float) -> Array:
    return np.asarray(from_spherical(abs(angle_rad), 0.0 if angle_rad >= 0.0 else np.pi))


def _registered(values: Array) -> tuple[Array, tuple[str, ...]]:
    """Pictures whose red and blue are moved along the rows onto green, by the shift that agrees best over all."""
    moved, notes = values.copy(), []
    middle = values.mean(axis=(1, 2), keepdims=True)
    detail = [_detail(channel) for channel in np.moveaxis(values / middle, -1, 0)]
    for channel, name in ((0, "red"), (2, "blue")):
        steps = np.arange(-_MOST_SHIFT_PX, _MOST_SHIFT_PX + 1e-9, _SHIFT_STEP_PX)
        agreement = _agreement(detail[1], detail[channel], steps)
        best = int(np.argmax(agreement))
        if agreement[best] < _LEAST_CORRELATION:
            notes.append(f"{name} has too little detail to register it with green")
            continue
        if abs(steps[best]) >= _SHIFT_STEP_PX:
            moved[..., channel] = shift(
                values[..., channel], (0.0, steps[best], 0.0), order=3, mode="nearest"
            )
            notes.append(f"{name} moved by {steps[best]:+.2f} pixels along the rows onto green")
    margin = int(_MOST_SHIFT_PX) + 1
    return np.maximum(moved[:, margin:-margin], _HALF_CODE), tuple(notes)


def _detail(pictures: Array) -> Array:
    return np.asarray(pictures - gaussian_filter(pictures, (0.0, _DETAIL_PX, _DETAIL_PX)))


def _agreement(fixed: Array, moving: Array, steps: Array) -> Array:
    """Correlation of one channel's detail with another's moved along the rows, by Fourier shifts; one a step."""
    spectra = [np.fft.rfft2(channel.swapaxes(1, 2)) for channel in (fixed, moving)]
    cross = np.sum(np.conj(spectra[0]) * spectra[1], axis=(0, 1))
    n = fixed.shape[1]
    frequencies = np.arange(len(cross)) * 2.0 * np.pi / n
    twice = np.where((np.arange(len(cross)) == 0) | (2 * np.arange(len(cross)) == n), 1.0, 2.0)
    products = np.array([np.sum(twice * np.real(cross * np.exp(-1j * frequencies * s))) for s in steps])
    return np.asarray(products / (n * fixed.shape[2]) / np.sqrt(np.sum(fixed**2) * np.sum(moving**2)))


def _require_belonging(path: Path, pictures: SurfacePictures) -> None:
    """Raise FileFormatError where a picture's mean differs from its reading much more than the others do."""
    factors = pictures.factors.mean(axis=-1)
    relative = factors / np.nanmedian(factors)
    for label, value in zip(pictures.labels, relative, strict=True):
        if value > _MOST_FACTOR or value < 1.0 / _MOST_FACTOR:
            raise FileFormatError(
                f"{path}: the picture {label} is {value:.2f} times as bright as its reading says, relative to the "
                "others; pictures and readings do not belong together"
            )
