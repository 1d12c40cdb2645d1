"""Reads picture files as linear sRGB: photographs, lights, and pictures to compare."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold.colour.conversion import decode_srgb
from manifold.core import disk
from manifold.core.errors import FileFormatError
from manifold.core.extras import require
from manifold.core.picture_bytes import KINDS
from manifold.core.records import Array, Mask

RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
"""Suffixes of cameras' raw files, which need rawpy."""
SUFFIXES = (".exr", ".hdr", ".pfm", ".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp", ".webp")
"""Suffixes of readable files; the format is determined from the content."""

_EXPECTED = "EXR, HDR, PFM, TIFF, PNG, JPEG, BMP or WebP"
_LINEAR = ("openexr", "hdr", "pnm", "tiff")  # unless a profile says otherwise
_MOST_BYTES = 1_200_000_000  # size of decoded values: 100 million pixels in single precision
_MOST_TILE = 1 << 24  # pixels of a tile, which is decoded whole
_TIFF_KINDS = {0: "white is 0", 3: "palette", 5: "CMYK", 6: "YCbCr", 8: "CIELAB"}
_PRIMARIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x, y of sRGB and its white
_MOST_CODE = 65535  # largest code of 16 bits
_RAW_WHITE = 0.999  # share of the largest code that counts as white: LibRaw rounds
_MOST_CHUNKS = 100
_HEIF = (b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif")  # brands behind `ftyp`
_SAY_COLOURS = {b"sRGB", b"gAMA", b"iCCP", b"cICP", b"cHRM"}  # chunks of PNG
_PLATEAU = 4  # pixels of the very same largest value may be clipped


@dataclass(frozen=True, eq=False)
class Image:
    """A picture in linear values.

    Attributes:
        values: linear sRGB, shape (H, W, 3), float32; transparent pixels have the values of the file.
        is_opaque: whether each pixel is not transparent, shape (H, W).
        is_clipped: whether each pixel may have been brighter than its value, shape (H, W): integers at their largest
            value, or floats if at least four pixels have the largest value.
        is_encoded: whether the file has display values, which were decoded as sRGB.
        is_grey: whether its channels are equal.
        notes: assumptions about the file, in sentences.
    """

    path: Path
    values: Array
    is_opaque: Mask
    is_clipped: Mask
    is_encoded: bool
    is_grey: bool
    notes: tuple[str, ...] = ()


def read_picture(path: Path) -> Image:
    """Read a picture as linear sRGB.

    EXR, HDR, PFM and TIFF are linear; other formats, and TIFF with a profile of sRGB, are decoded as sRGB.

    A 16-bit PNG file that names no colour space is also read as linear, as in photometric-stereo data sets. LibRaw
    develops raw files of cameras, in linear values, with the primaries of sRGB and the camera's white balance. The
    picture is turned upright if the file states its orientation. In EXR and TIFF, only the channels red, green, blue
    or grey, and alpha are read.
    """
    disk.require_regular(path, "name a picture (.exr, .hdr, .tif, .png, .jpg)")
    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_raw(path)
    try:
        return _read(path, _kind(path))
    except UnicodeDecodeError as error:  # of names, or of messages of OpenImageIO with parts of the file
        raise _unreadable(path, "a damaged header") from error


def _read(path: Path, kind: str) -> Image:
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
    is_encoded = _is_encoded(path, spec, kind)
    is_float = str(spec.format) in ("half", "float", "double")
    is_code = is_encoded and str(spec.format) in ("uint8", "uint16")
    stored = image.read_image("" if is_code else "float")
    if stored is None or image.has_error:
        raise _unreadable(path, image.geterror())
    if image.seek_subimage(1, 0):
        raise _unsupported(path, "several pictures")
    colours = [names.index(name) for name in ("RGB" if "R" in names else "YYY")]
    opaque = np.full(stored.shape[:2], True)
    if spec.alpha_channel >= 0:
        alpha = stored[..., spec.alpha_channel]
        opaque = alpha >= (np.iinfo(alpha.dtype).max if alpha.dtype.kind == "u" else 1.0)
    values, clipped = _linear(stored[..., colours], is_encoded, is_float)
    if 0.0 < (exposure := spec.get_float_attribute("hdr:exposure", 1.0)) < np.inf and exposure != 1.0:
        values /= np.float32(exposure)
    turn = spec.get_int_attribute("Orientation", 1)
    is_grey = colours[0] == colours[1] or all(
        np.array_equal(row[:, :2], row[:, 1:], equal_nan=True) for row in values
    )
    notes: tuple[str, ...] = ()
    if is_encoded:
        notes = (f"{path.name}: read as sRGB; the camera's tone curve and colour settings are not reversed",)
    elif kind == "png":
        notes = (f"{path.name}: 16 bits without a colour space: read as linear",)
    return Image(
        path,
        _upright(values, turn),
        _upright(opaque, turn),
        _upright(clipped, turn),
        is_encoded,
        is_grey,
        notes,
    )


def _read_raw(path: Path) -> Image:
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
    clipped: Mask = np.any(codes >= _RAW_WHITE * _MOST_CODE, axis=2)
    values = (np.asarray(codes) / _MOST_CODE).astype(np.float32)
    notes = (f"{path.name}: developed with the camera's white balance",)
    return Image(path, values, np.full(clipped.shape, True), clipped, False, False, notes)


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
    primaries = spec.getattribute("chromaticities")
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
            primaries is not None and not np.allclose(primaries, _PRIMARIES, atol=2e-3),  # rounded in files
            f"primaries and white at {primaries}",
        ),
        (
            (x, y, width, height) != whole,
            f"{width} x {height} pixels at {x}, {y} of {whole[2]} x {whole[3]} at {whole[0]}, {whole[1]}",
        ),
    )  # fmt: skip
    found = [what for applies, what in refused if applies]
    if found:
        raise _unsupported(path, found[0])


def _is_encoded(path: Path, spec: Any, kind: str) -> bool:
    """Return whether values are encoded for a display.

    Raises FileFormatError if they are neither that nor linear sRGB.
    """
    profile = spec.getattribute("ICCProfile")
    space = "" if kind == "pnm" else spec.get_string_attribute("oiio:ColorSpace")
    if profile is not None:
        found = _encoding(bytes(profile), spec.nchannels)
        space = spec.get_string_attribute("ICCProfile:profile_description") or "its profile"
    elif kind == "png" and str(spec.format) == "uint16" and not _SAY_COLOURS & _chunks(path):
        return False
    elif not space:
        found = kind not in _LINEAR
    else:
        name = space.lower()
        is_srgb = name.startswith(("srgb", "g22_rec709"))
        found = is_srgb or (False if name.startswith(("lin_rec709", "linear", "lin_srgb")) else None)
    if found is None:
        raise FileFormatError(f"{path}: colours in {space}, expected sRGB or linear sRGB; convert it")
    return found


def _chunks(path: Path) -> set[bytes]:
    """Return the types of the chunks of a PNG file before its pixels."""
    found: set[bytes] = set()
    with path.open("rb") as stream:
        stream.seek(8)
        while len(head := stream.read(8)) == 8 and head[4:] != b"IDAT" and len(found) < _MOST_CHUNKS:
            found.add(head[4:])
            stream.seek(int.from_bytes(head[:4], "big") + 4, 1)
    return found


def _encoding(profile: bytes, n_channels: int) -> bool | None:
    """Return True for a profile of sRGB, False for one of linear sRGB, None for others."""
    from PIL import Image, ImageCms

    ramp = np.arange(256, dtype=np.uint8)
    shown = np.stack([ramp] * 3 if n_channels < 3 else [ramp, ramp[::-1], np.roll(ramp, 85)], axis=1)
    try:
        taken = ImageCms.profileToProfile(
            Image.fromarray(shown[None, :, 0] if n_channels < 3 else shown[None]),
            ImageCms.ImageCmsProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB"),
            ImageCms.Intent.RELATIVE_COLORIMETRIC, outputMode="RGB",
        )  # fmt: skip
    except (OSError, ImageCms.PyCMSError):
        return None
    seen = decode_srgb(np.asarray(taken)[0] / 255.0)
    for is_encoded, expected in ((True, decode_srgb(shown / 255.0)), (False, shown / 255.0)):
        if np.abs(seen - expected).max() < 0.02:  # rounding to 8 bits, twice
            return is_encoded
    return None


def _linear(stored: Array, is_encoded: bool, is_float: bool) -> tuple[Array, Mask]:
    """Return linear float32 values of stored codes or floats (H, W, 3), and a mask of clipped pixels."""
    full = {"uint8": 255, "uint16": _MOST_CODE}.get(str(stored.dtype), 1)
    most = np.max(stored, where=np.isfinite(stored), initial=0) if is_float else full
    clipped: Mask = np.any(np.equal(stored, most), axis=2)
    if is_float:
        clipped &= np.count_nonzero(clipped) >= _PLATEAU
    if not is_encoded:
        return np.array(stored, dtype=np.float32), clipped
    if full > 1:
        table = decode_srgb(np.arange(full + 1) / full).astype(np.float32)
        values = np.empty(stored.shape, np.float32)
        for row, codes in zip(values, stored, strict=True):  # as an index, a code takes eight bytes
            row[...] = table[codes]
        return values, clipped
    return decode_srgb(stored).astype(np.float32), clipped


def _upright(pixels: Any, orientation: int) -> Any:
    """Turn and mirror pixels (H, W, ...) by TIFF 6.0's number of the orientation."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels)
