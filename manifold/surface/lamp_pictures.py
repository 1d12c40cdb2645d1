"""Pictures of one spot of a surface from one camera, each under one lamp of known direction or in diffuse light."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter

from manifold.colour.picture_files import SUFFIXES, Image, notes_together, read_picture
from manifold.core.defaults import TINY
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.names import percent
from manifold.core.records import Array, Mask
from manifold.estimate.lamps import intensities_beside, intensity_notes, read_lamps, require_in_front
from manifold.estimate.picture_colours import colour_of, odd_picture, reading_at
from manifold.formats.readings import Readings
from manifold.formats.workbook_pictures import picture_directions, picture_geometry, picture_values

_LEAST_LAMPS = 3  # for albedo and two slopes
_LEAST_SIZE = 32  # pixels a side
_MOST_PIXELS = 12_000_000  # of a picture
_MOST_TOGETHER = 64_000_000  # pixels of all pictures, of which an estimate takes 4 GB
_DETAIL_PX = 3.0  # what is finer registers the colours
_MOST_SHIFT_PX = 2.0
_SHIFT_STEP_PX = 0.05  # of the search; colours of an MA-T12 are up to 0.9 px apart
_LEAST_CORRELATION = 0.3  # of fine detail between two channels, to register them
_HALF_CODE = 0.5 / 255.0
_ABOVE = float(np.cos(np.deg2rad(1.0)))  # least cosine of a camera above the sample
_FEW_CLIPPED = 0.001  # share of a picture's pixels, such as glints and dead ones


@dataclass(frozen=True, eq=False)
class SurfacePictures:
    """J pictures of one spot of a surface, with H rows and W columns.

    Columns point along x, rows against y, both in the plane of the sample; z is its normal.

    Attributes:
        name: name of the specimen.
        values: linear sRGB, shape (J, H, W, 3), above 0; channels registered to each other.
        lamps: unit vectors towards the lamps, shape (J, 3); NaN for diffuse light.
        camera: unit vector towards the camera, shape (3,).
        labels: the J names of the pictures in their source.
        means: mean linear sRGB of the reading at the geometry of each picture, 1 for a white diffuser, shape (J,
            3); NaN without a reading.
        notes: assumptions, in sentences.
        sources: files from which the pictures were read.
    """

    name: str
    values: Array
    lamps: Array
    camera: Array
    labels: tuple[str, ...]
    means: Array
    notes: tuple[str, ...] = ()
    sources: tuple[Path, ...] = ()

    @property
    def is_diffuse(self) -> Mask:
        """Mask of the pictures in diffuse light, shape (J,)."""
        return np.isnan(self.lamps[:, 0])

    @property
    def is_from_above(self) -> bool:
        """Whether the camera looks along the normal."""
        return bool(self.camera[2] > _ABOVE)

    def without(self, picture: int) -> SurfacePictures:
        """Return the pictures without the one with this index."""
        kept = [j for j in range(len(self.labels)) if j != picture]
        return replace(
            self, values=self.values[kept], lamps=self.lamps[kept], labels=tuple(self.labels[j] for j in kept),
            means=self.means[kept],
        )  # fmt: skip

    @property
    def factors(self) -> Array:
        """Return the ratio of each picture's mean colour to that of its reading, shape (J, 3).

        It is NaN for pictures without a reading.
        """
        return np.asarray(self.values.mean(axis=(1, 2)) / self.means)


def read_workbook(path: Path, sample: str | None = None) -> tuple[SurfacePictures, Readings]:
    """Read the pictures and the readings of a workbook of a multi-angle spectrophotometer.

    Args:
        path: `.xlsx` with a sheet `Texture Images`.
        sample: name of the specimen, for a workbook with several.

    Raises:
        FileFormatError: the workbook has fewer than three pictures under lamps, their sizes differ, or their means
            contradict the readings at the same geometries.
    """
    from manifold.formats.registry import read_readings

    readings = read_readings(path, sample)
    images: Mapping[str, bytes] = readings.texture.get("images", {})
    found = {c: geometry for c in images if (geometry := picture_geometry(c)) is not None}
    captions = tuple(found)
    angles = np.array([lamp for _, lamp in found.values()])
    if np.sum(np.isfinite(angles)) < _LEAST_LAMPS:
        raise FileFormatError(
            f"{path}: found {len(captions)} pictures with a geometry, expected at least {_LEAST_LAMPS} under lamps in "
            "a sheet 'Texture Images'; export the workbook with its pictures"
        )
    values = _stacked(path, (_decoded(path, c, images[c]) for c in captions), len(captions))
    means = [
        np.full(3, np.nan)
        if np.isnan(lamp)
        else colour_of(readings, reading_at(readings, *picture_directions(camera, lamp)))
        for camera, lamp in found.values()
    ]
    values, registered = _registered(values)
    pictures = SurfacePictures(
        readings.name, values, in_plane(angles), in_plane(-found[captions[0]][0]), captions, np.array(means),
        registered, (path,),
    )  # fmt: skip
    if (fault := odd_picture(captions, pictures.factors)) is not None:
        raise FileFormatError(f"{path}: {fault}")
    return pictures, readings


def read_folder(pictures: Sequence[Path], lamps: Path, is_linear: bool | None = None) -> SurfacePictures:
    """Read pictures of a flat specimen that is seen from above.

    Args:
        pictures: one file per lamp, in the order of the lamps unless the lamps name their pictures.
        lamps: text file of directions (see `estimate.lamps.read_lamps`); x points right in the pictures, y up, z
            towards the camera.
        is_linear: whether the values of the pictures are linear, see `colour.picture_files.read_picture`; None as
            their files say.

    Raises:
        UsageError: the numbers of lamps and pictures differ, or a lamp is not in front of the surface.
        FileFormatError: a line is not a direction, or the sizes of the pictures differ.
    """
    names = tuple(path.name for path in pictures)
    found = read_lamps(lamps, names)
    if len(found) != len(pictures) or len(found) < _LEAST_LAMPS:
        raise UsageError(
            f"{lamps}: found {len(found)} lamps for {len(pictures)} pictures, expected one per picture, at least "
            f"{_LEAST_LAMPS} or more"
        )
    require_in_front(found, names, TINY, "the surface")
    beside = intensities_beside(lamps)
    told: list[tuple[str, Sequence[str]]] = []

    def read() -> Iterable[Array]:
        for path, lamp in zip(pictures, found, strict=True):
            picture = read_picture(path, is_linear, finds_plateaus=True)
            told.append((path.name, (*picture.notes, *_clipped(picture))))
            yield picture.values / lamp.colour

    values = _stacked(lamps, read(), len(pictures))
    np.maximum(values, _HALF_CODE, out=values)
    return SurfacePictures(
        pictures[0].parent.resolve().name, values, np.array([lamp.direction for lamp in found]),
        np.array([0.0, 0.0, 1.0]), names, np.full((len(found), 3), np.nan),
        (
            "no readings: colours are relative to the brightest points, slopes as steep as a Lambertian's would be",
            *intensity_notes(lamps),
            *notes_together(told),
        ),
        (*pictures, lamps, *(() if beside is None else (beside,))),
    )  # fmt: skip


def _clipped(picture: Image) -> tuple[str, ...]:
    """Return a note about a picture with clipped pixels, whose colours and slopes are not known."""
    share = float(np.mean(picture.is_clipped.any(axis=2)))
    if share < _FEW_CLIPPED:
        return ()
    return (
        f"{picture.path.name}: more than {percent(_FEW_CLIPPED, 1)} of the pixels are clipped, where colours and "
        "slopes are wrong; expose it less",
    )


def files_in(sources: Sequence[Path]) -> list[Path]:
    """Return the given files and the pictures in the given folders, sorted by name within each folder."""
    found = []
    for source in sources:
        if source.is_dir():
            found += sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
        else:
            found.append(source)
    return found


def in_plane(angles_deg: Array | float) -> Array:
    """Return unit vectors in the plane of the lamps, which is vertical in pictures; positive angles point down."""
    angles = np.deg2rad(angles_deg)
    return np.stack([0.0 * angles, -np.sin(angles), np.cos(angles)], axis=-1)


def _decoded(path: Path, caption: str, content: bytes) -> Array:
    """Decode one picture of a workbook to linear values."""
    try:
        return picture_values(content)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: the picture {caption} {error}") from None


def _stacked(path: Path, pictures: Iterable[Array], count: int) -> Array:
    """Stack `count` pictures of equal size; reading stops at the first picture of another size."""
    stack = np.empty((0, 0, 0, 3))
    for j, picture in enumerate(pictures):
        h, w = picture.shape[:2]
        if j == 0:
            if min(h, w) < _LEAST_SIZE or h * w > _MOST_PIXELS or count * h * w > _MOST_TOGETHER:
                raise FileFormatError(
                    f"{path}: found {count} pictures of {w} x {h} pixels, expected at least {_LEAST_SIZE} x "
                    f"{_LEAST_SIZE}, at most {_MOST_PIXELS / 1e6:g} million each and {_MOST_TOGETHER / 1e6:g} million "
                    "together; crop or scale all of them alike"
                )
            stack = np.empty((count, h, w, 3))
        if picture.shape != stack.shape[1:]:
            raise FileFormatError(
                f"{path}: found pictures of {stack.shape[2]} x {stack.shape[1]} and {w} x {h} pixels, expected one size"
            )
        stack[j] = picture
    return stack


def _registered(values: Array) -> tuple[Array, tuple[str, ...]]:
    """Align red and blue of the pictures with green, by the shift along the rows that fits all best."""
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
            rows = np.arange(values.shape[1])
            spline = make_interp_spline(rows, values[..., channel], axis=1, check_finite=False)
            moved[..., channel] = spline(rows - steps[best])
            notes.append(f"{name} shifted by {steps[best]:+.2f} pixels along the rows to align with green")
    margin = int(_MOST_SHIFT_PX) + 1
    return np.maximum(moved[:, margin:-margin], _HALF_CODE), tuple(notes)


def _detail(pictures: Array) -> Array:
    return np.asarray(pictures - gaussian_filter(pictures, (0.0, _DETAIL_PX, _DETAIL_PX)))


def _agreement(fixed: Array, moving: Array, steps: Array) -> Array:
    """Return the correlation of two channels' detail for each shift of one along the rows."""
    spectra = [np.fft.rfft2(channel.swapaxes(1, 2)) for channel in (fixed, moving)]
    cross = np.sum(np.conj(spectra[0]) * spectra[1], axis=(0, 1))
    n = fixed.shape[1]
    frequencies = np.arange(len(cross)) * 2.0 * np.pi / n
    twice = np.where((np.arange(len(cross)) == 0) | (2 * np.arange(len(cross)) == n), 1.0, 2.0)
    products = np.array([np.sum(twice * np.real(cross * np.exp(-1j * frequencies * s))) for s in steps])
    return np.asarray(products / (n * fixed.shape[2]) / np.sqrt(np.sum(fixed**2) * np.sum(moving**2)))
