"""Reads picture files as linear sRGB: photographs, lights, and pictures to compare."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifold.colour import colour_spaces
from manifold.colour.colour_spaces import SRGB, ColourSpace
from manifold.colour.saturation import find_plateau
from manifold.core import disk
from manifold.core.errors import FileFormatError
from manifold.core.extras import require
from manifold.core.names import first_few, percent
from manifold.core.picture_bytes import KINDS, tags
from manifold.core.records import Array, Mask

RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
"""Suffixes of cameras' raw files, which need rawpy."""
SUFFIXES = (".exr", ".hdr", ".pfm", ".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".webp")
"""Suffixes of readable files; the format is determined from the content."""

_EXPECTED = "EXR, HDR, PFM, TIFF, PNG, JPEG, BMP or WebP"
_LINEAR = ("openexr", "hdr", "pnm")  # by their specifications
_MOST_BYTES = 1_200_000_000  # size of decoded values: 100 million pixels in single precision
_MOST_TILE = 1 << 24  # pixels of a tile, which is decoded whole
_TIFF_KINDS = {0: "white is 0", 3: "palette", 5: "CMYK", 6: "YCbCr", 8: "CIELAB"}
_MOST_CODE = 65535  # largest code of 16 bits
_CODES = {"uint8": 255, "uint16": _MOST_CODE}  # largest codes, by type
_RAW_WHITE = 0.999  # share of the largest code that counts as white: LibRaw rounds
_MOST_CHUNKS, _MOST_CHUNK = 100, 64  # chunks before the pixels, and bytes of one that states colours
_HEIF = (b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif")  # brands behind `ftyp`
_SAY_COLOURS = {b"sRGB", b"gAMA", b"cICP", b"cHRM"}  # chunks of PNG, beside the profile
_UNSPECIFIED = b"\2"  # primaries in cICP, see ITU-T H.273
_COLOUR_SPACE, _WHITE_POINT, _PRIMARIES = 0xA001, 318, 319  # tags of Exif and TIFF
_EXIF_SRGB, _EXIF_ADOBE, _ADOBE = 1, 2, "R03"  # values of _COLOUR_SPACE, and the interoperability index
_OUTSIDE = 0.02  # of its largest channel, how negative a colour's smallest one is that counts as outside sRGB
_FEW_OUTSIDE = 0.01  # share of the pixels; fewer are not noted
_FULL = 0.98  # share of the largest code above which a plateau is that of the code
_PLATEAU = 4  # pixels of the very same largest value may be clipped


@dataclass(frozen=True, eq=False)
class Image:
    """A picture in linear values.

    Attributes:
        path: its file.
        values: linear sRGB, shape (H, W, 3), float32; transparent pixels have the values of the file. Colours that
            the conversion leaves outside sRGB have 0 where they would be negative.
        is_opaque: whether each pixel is not transparent, shape (H, W).
        is_clipped: whether each channel of a pixel may have been brighter than its value, shape (H, W, 3): integers at
            their largest value, floats if at least four pixels have the largest value, and plateaus if they were
            searched for. All channels of a pixel that was converted from another colour space are clipped if any was.
        is_encoded: whether the file has display values, which were decoded.
        is_certain: whether that follows from the format or was given; a statement of the file may be wrong.
        is_guessed: whether that was guessed, because the file does not say.
        is_grey: whether its channels are equal.
        notes: assumptions about the file, in sentences.
    """

    path: Path
    values: Array
    is_opaque: Mask
    is_clipped: Mask
    is_encoded: bool
    is_certain: bool
    is_guessed: bool
    is_grey: bool
    notes: tuple[str, ...] = ()


def read_picture(path: Path, is_linear: bool | None = None, *, finds_plateaus: bool = False) -> Image:
    """Read a picture as linear sRGB.

    Every file is read in the colour space that it states: by a profile, by chunks of PNG, by tags of Exif or TIFF, or
    by primaries of EXR. Where a file does not say whether its values are linear, 8 bits are decoded as sRGB; 16 bits
    and floats are linear, as in photometric-stereo data sets. EXR, HDR, PFM and raw files are always linear.

    LibRaw develops raw files of cameras, in linear values, with the primaries of sRGB and the camera's white balance.
    The picture is turned upright if the file states its orientation. In EXR and TIFF, only the channels red, green,
    blue or grey, and alpha are read.

    Args:
        path: a picture; its format follows from its content.
        is_linear: True if the values are linear, False if they are encoded for a display; this overrides the file.
            None follows the file. The primaries are always those of the file.
        finds_plateaus: whether to search for saturated pixels below the largest code, as photographs may have.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: the file is no readable picture, or its colour space is not understood.
    """
    disk.require_regular(path, "name a picture (.exr, .hdr, .tif, .png, .jpg)")
    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_raw(path, finds_plateaus)
    try:
        return _read(path, _kind(path), is_linear, finds_plateaus)
    except UnicodeDecodeError as error:  # of names, or of messages of OpenImageIO with parts of the file
        raise _unreadable(path, "a damaged header") from error


def _read(path: Path, kind: str, is_linear: bool | None, finds_plateaus: bool) -> Image:
    OpenImageIO = require("OpenImageIO")

    OpenImageIO.attribute("threads", 1)  # processes that are forked have no threads
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    image = OpenImageIO.ImageInput.open(str(path), config)
    if image is None:
        raise _unreadable(path, OpenImageIO.geterror())
    spec = image.spec()
    _require_kind(path, image, kind)
    names = list(spec.channelnames)
    space = _stated_space(path, spec, kind)
    coding = _coding(path, space, kind, str(spec.format), is_linear)
    is_float = str(spec.format) in ("half", "float", "double")
    stored = image.read_image("" if str(spec.format) in _CODES else "float")
    if stored is None or image.has_error:
        raise _unreadable(path, image.geterror())
    if image.seek_subimage(1, 0):
        raise _unsupported(path, "several pictures")
    colours = [names.index(name) for name in ("RGB" if "R" in names else "YYY")]
    opaque = np.full(stored.shape[:2], True)
    if spec.alpha_channel >= 0:
        alpha = stored[..., spec.alpha_channel]
        opaque = alpha >= _CODES.get(str(alpha.dtype), 1.0)
    codes = stored[..., colours]
    clipped, notes = _with_plateaus(path, codes, _clipped(codes, is_float), finds_plateaus)
    notes += coding.notes
    values = _linear(codes, coding.curves)
    if space.to_srgb is not None:
        notes += _convert(path, values, space)
        clipped = _in_every_channel(clipped)
    if 0.0 < (exposure := spec.get_float_attribute("hdr:exposure", 1.0)) < np.inf and exposure != 1.0:
        values /= np.float32(exposure)
    turn = spec.get_int_attribute("Orientation", 1)
    is_grey = colours[0] == colours[1] or all(
        np.array_equal(row[:, :2], row[:, 1:], equal_nan=True) for row in values
    )
    return Image(
        path,
        _upright(values, turn),
        _upright(opaque, turn),
        _upright(clipped, turn),
        is_encoded=bool(coding.curves),
        is_certain=coding.is_certain,
        is_guessed=coding.is_guessed,
        is_grey=is_grey,
        notes=notes,
    )


def notes_together(pictures: Iterable[tuple[str, Iterable[str]]]) -> dict[str, int]:
    """Merge the notes on pictures, given with their names; return how many pictures each note concerns.

    Notes that differ only in the name with which they begin become one.
    """
    named: dict[str, list[str]] = {}
    for name, notes in pictures:
        for note in dict.fromkeys(notes):
            rest = note.removeprefix(f"{name}: ")
            named.setdefault(rest, []).append(name if rest != note else "")
    return {
        f"{first_few(names)}: {note}" if all(names) else note: len(names) for note, names in named.items()
    }


class _Coding(NamedTuple):
    """How a file's codes become linear values, whether that is certain or a guess, and notes about it."""

    curves: tuple[colour_spaces.Curve, ...]
    is_certain: bool
    is_guessed: bool
    notes: tuple[str, ...]


def _coding(path: Path, space: ColourSpace, kind: str, stored: str, is_linear: bool | None) -> _Coding:
    """Return how values become linear, in this order: by the format, as asked for, as the file states, by a guess."""
    name, tone = path.name, "the camera's tone curve and colour settings are not reversed"
    if kind in _LINEAR and not space.curves:
        notes = (f"{name}: linear by its format; --encoded does not change it",) * (is_linear is False)
        return _Coding((), True, False, notes)
    if is_linear:
        return _Coding((), True, False, (f"{name}: values read as linear",))
    if is_linear is not None or space.curves is not None:
        curves = space.curves if is_linear is None else space.curves or SRGB.curves
        notes = (f"{name}: read as {space.name}; {tone}",) if curves else ()
        return _Coding(curves or (), is_linear is not None, False, notes)
    if stored == "uint8":
        words = (
            f"{name}: read as {space.name}; {tone}; the file states no encoding, add --linear if it is linear"
        )
        return _Coding(SRGB.curves or (), False, True, (words,))
    words = f"{name}: read as linear; the file states no encoding, add --encoded if it is encoded"
    return _Coding((), False, True, (words,))


def _read_raw(path: Path, finds_plateaus: bool) -> Image:
    """Read a raw file, developed without curves."""
    rawpy = require("rawpy")
    try:
        with rawpy.imread(str(path)) as raw:
            n_bytes = 12 * raw.sizes.iheight * raw.sizes.iwidth
            if n_bytes > _MOST_BYTES:
                raise _unsupported(path, f"{raw.sizes.iwidth} x {raw.sizes.iheight} pixels")
            codes = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                output_color=rawpy.ColorSpace.sRGB,
            )
    except rawpy.LibRawError as error:
        raise _unreadable(path, str(error)) from error
    clipped: Mask = codes >= _RAW_WHITE * _MOST_CODE
    values = (np.asarray(codes) / _MOST_CODE).astype(np.float32)
    clipped, notes = _with_plateaus(path, codes, clipped, finds_plateaus)
    notes += (f"{path.name}: developed with the camera's white balance",)
    return Image(
        path, values, np.full(clipped.shape[:2], True), _in_every_channel(clipped),
        is_encoded=False, is_certain=True, is_guessed=False, is_grey=False, notes=notes,
    )  # fmt: skip


def _kind(path: Path) -> str:
    """Return OpenImageIO's name of the format, by a file's first bytes, so that no other reader is tried."""
    try:
        with path.open("rb") as stream:
            head = stream.read(12)
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from error
    for magic, kind in KINDS.items():
        if head.startswith(magic) and (kind != "webp" or head.endswith(b"WEBP")):
            return kind
    if head[4:8] == b"ftyp" and head[8:12] in _HEIF:
        raise FileFormatError(
            f"{path}: a HEIC or AVIF picture, expected {_EXPECTED}; convert it: magick {path.name} {path.stem}.png, "
            f"or on macOS sips -s format tiff {path.name} --out {path.stem}.tif"
        )
    raise FileFormatError(f"{path}: not a readable picture (it begins with {head!r}), expected {_EXPECTED}")


def _unsupported(path: Path, found: str) -> FileFormatError:
    return FileFormatError(
        f"{path}: found {found}, expected one RGB or grey picture in sRGB; save it in that form"
    )


def _unreadable(path: Path, reason: str) -> FileFormatError:
    return FileFormatError(
        f"{path}: not a readable picture ({' '.join(reason.split())[:120]}); save it again"
    )


def _require_kind(path: Path, image: Any, kind: str) -> None:
    """Raise FileFormatError unless an open file has one RGB or grey picture of a supported kind and size."""
    spec, names = image.spec(), list(image.spec().channelnames)
    photometric = spec.get_int_attribute("tiff:PhotometricInterpretation", 2)
    x, y, width, height = spec.x, spec.y, spec.width, spec.height
    whole = (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    n_bytes = width * height * spec.nchannels * max(spec.format.size(), 4)
    is_large = n_bytes > _MOST_BYTES or spec.tile_width * spec.tile_height > _MOST_TILE
    refused = (
        (image.format_name() != kind, f"it begins as {kind}, and is {image.format_name()}"),
        (spec.deep or spec.depth > 1, "a deep or three-dimensional picture"),
        (
            is_large,
            f"{width} x {height} pixels of {spec.nchannels} channels, tiles of {spec.tile_width} x {spec.tile_height}",
        ),
        (
            kind == "tiff" and photometric not in (1, 2),
            f"{_TIFF_KINDS.get(photometric, 'PhotometricInterpretation')} ({photometric})",
        ),
        (spec.get_int_attribute("tiff:subfiletype", 0) & 1, f"a thumbnail of {width} x {height} pixels"),
        (spec.get_string_attribute("jpeg:ColorSpace") == "CMYK", "CMYK"),
        (not {"R", "G", "B"} <= {*names} and not {"Y"} <= {*names} <= {"Y", "A", "Z"}, f"channels {', '.join(names)}"),
        (
            (x, y, width, height) != whole,
            f"{width} x {height} pixels at {x}, {y} of {whole[2]} x {whole[3]} at {whole[0]}, {whole[1]}",
        ),
    )  # fmt: skip
    found = [what for applies, what in refused if applies]
    if found:
        raise _unsupported(path, found[0])


def _stated_space(path: Path, spec: Any, kind: str) -> ColourSpace:
    """Return the colour space that a file states, without curves if it states none.

    Raises FileFormatError if it is not understood.
    """
    profile, primaries = spec.getattribute("ICCProfile"), spec.getattribute("chromaticities")
    chunks = _chunks(path) if kind == "png" else {}
    space: ColourSpace | None
    if profile is not None and b"cICP" not in chunks:
        name = spec.get_string_attribute("ICCProfile:profile_description") or "its profile"
        space = colour_spaces.of_profile(bytes(profile), name)
    elif chunks:
        name = f"its chunk cICP {tuple(chunks[b'cICP'])}" if b"cICP" in chunks else "its chunk cHRM"
        space = colour_spaces.of_png(chunks)
    elif primaries is not None:
        name = f"primaries and white at {primaries}"
        space = colour_spaces.of_primaries(primaries, None)
    elif kind == "openexr" and (name := spec.get_string_attribute("oiio:ColorSpace")):
        space = colour_spaces.named(name)
    else:
        name = "its tags"
        space = _tagged_space(path, kind)
    if space is None:
        raise FileFormatError(
            f"{path}: colours in {name}, expected a space of primaries and tone curves, such as sRGB, Display P3 or "
            "Adobe RGB; convert it"
        )
    return space


def _tagged_space(path: Path, kind: str) -> ColourSpace | None:
    """Return the space that tags of Exif or TIFF state; None if the primaries are impossible."""
    stated, interoperability = tags(path, kind)
    space = stated.get(_COLOUR_SPACE)
    if space == _EXIF_SRGB:
        return SRGB
    if space == _EXIF_ADOBE or interoperability == _ADOBE:
        return colour_spaces.adobe_rgb()
    if _PRIMARIES in stated and _WHITE_POINT in stated:
        try:
            numbers = [float(v) for v in (*stated[_PRIMARIES], *stated[_WHITE_POINT])]
            return colour_spaces.of_primaries(numbers, None)
        except (TypeError, ValueError, ZeroDivisionError):
            return None
    return ColourSpace("sRGB")


def _chunks(path: Path) -> dict[bytes, bytes]:
    """Return the chunks of a PNG file before its pixels that state colours, by type."""
    found: dict[bytes, bytes] = {}
    with path.open("rb") as stream:
        stream.seek(8)
        for _ in range(_MOST_CHUNKS):
            head = stream.read(8)
            if len(head) < 8 or head[4:] == b"IDAT":
                break
            size = int.from_bytes(head[:4], "big")
            if head[4:] in _SAY_COLOURS and size <= _MOST_CHUNK:
                found[head[4:]] = stream.read(size)
                size = 0
            stream.seek(size + 4, 1)
    if found.get(b"cICP", b"").startswith(_UNSPECIFIED):
        del found[b"cICP"]
    return found


def _clipped(codes: Array, is_float: bool) -> Mask:
    """Return which stored codes or floats (H, W, 3) have the largest value."""
    full = _CODES.get(str(codes.dtype), 1)
    most = np.max(codes, where=np.isfinite(codes), initial=0) if is_float else full
    clipped: Mask = np.equal(codes, most)
    if is_float:
        clipped &= np.count_nonzero(clipped.any(axis=2)) >= _PLATEAU
    return clipped


def _in_every_channel(clipped: Mask) -> Mask:
    """Return a mask (H, W, 3) that is set in every channel of the pixels in which it was set in any."""
    return np.broadcast_to(clipped.any(axis=2, keepdims=True), clipped.shape)


def _with_plateaus(
    path: Path, codes: Array, clipped: Mask, finds_plateaus: bool
) -> tuple[Mask, tuple[str, ...]]:
    """Add stored codes or floats (H, W, 3) that lie on plateaus of their channel to clipped ones, with a note."""
    if not finds_plateaus:
        return clipped, ()
    full = _CODES.get(str(codes.dtype), 1)
    found, on_plateau = {}, np.zeros(codes.shape, bool)
    for c in range(3):
        if c and np.array_equal(codes[..., c], codes[..., 0]):  # grey
            on_plateau[..., c] = on_plateau[..., 0]
        elif (plateau := find_plateau(codes[..., c])) is not None:
            found["RGB"[c]], on_plateau[..., c] = plateau, plateau.pixels
    below = [
        f"{name} {one.level / full:.3g}"
        for name, one in found.items()
        if one.level < _FULL * full or full == 1
    ]
    if not below:
        return clipped | on_plateau, ()
    count = np.count_nonzero(on_plateau.any(axis=2))
    return clipped | on_plateau, (
        f"{path.name}: {count} pixels lie on a plateau ({', '.join(below)} of the largest code) and "
        "are treated as clipped: they may have been brighter",
    )


def _convert(path: Path, values: Array, space: ColourSpace) -> tuple[str, ...]:
    """Convert linear values (H, W, 3) of a space to sRGB in place; return a note if many colours are outside sRGB."""
    assert space.to_srgb is not None
    outside = 0
    for row in values:
        row[...] = row @ space.to_srgb
        outside += int(np.count_nonzero(row.min(axis=1) < -_OUTSIDE * row.max(axis=1)))
        np.maximum(row, 0.0, out=row)
    share = outside / max(values.shape[0] * values.shape[1], 1)
    if share < _FEW_OUTSIDE:
        return ()
    return (
        f"{path.name}: {percent(share)} of the pixels have colours outside sRGB, where a channel is set to 0",
    )


def _linear(codes: Array, curves: tuple[colour_spaces.Curve, ...]) -> Array:
    """Return linear values, float32, of stored codes or floats (H, W, 3)."""
    full = _CODES.get(str(codes.dtype), 1)
    each = curves or ((lambda stored: stored),)
    values = np.empty(codes.shape, np.float32)
    if full > 1:
        tables = np.array([curve(np.arange(full + 1) / full) for curve in each], np.float32)
        channel = np.arange(3) % len(each)
    for row, stored in zip(values, codes, strict=True):  # as an index, a code takes eight bytes
        if full > 1:
            row[...] = tables[channel, stored]
        else:
            row[...] = np.stack([each[c % len(each)](stored[:, c]) for c in range(3)], axis=1)
    return values


def _upright(pixels: Any, orientation: int) -> Any:
    """Turn and mirror pixels (H, W, ...) by TIFF 6.0's number of the orientation."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels)
