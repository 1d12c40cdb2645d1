"""Decodes PNG and JPEG pictures, and reads tags of pictures; no other module opens pictures with Pillow.

Pillow recognises pictures by content and starts Ghostscript for EPS files. Therefore this module derives the format
from the first bytes and passes it to Pillow.
"""

from __future__ import annotations

import io
import struct
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np

from manifold.core.errors import FileFormatError
from manifold.core.records import Array

_MOST_PIXELS = 1 << 26
KINDS = {
    b"\x76\x2f\x31\x01": "openexr", b"#?": "hdr", b"PF": "pnm", b"Pf": "pnm", b"II*\0": "tiff", b"MM\0*": "tiff",
    b"II+\0": "tiff", b"MM\0+": "tiff", b"\x89PNG": "png", b"\xff\xd8\xff": "jpeg", b"BM": "bmp", b"RIFF": "webp",
}  # fmt: skip
"""Kinds of pictures by the first bytes of their files."""

_MAGIC = {b"\x89PNG\r\n\x1a\n": "PNG", b"\xff\xd8\xff": "JPEG"}
_OTHERS = {
    b"GIF8": "a GIF", b"%!PS": "a PostScript", b"BM": "a BMP", b"II*\0": "a TIFF", b"MM\0*": "a TIFF",
    b"RIFF": "a WebP", b"\xd7\xcd\xc6\x9a": "a WMF", b"\x01\0\0\0": "an EMF", b"<svg": "an SVG", b"<?xml": "an SVG",
}  # fmt: skip
_TAGGED = ("jpeg", "png", "tiff", "webp")
_EXIF, _INTEROPERABILITY = 0x8769, 0xA005  # tags of the directories
_MODES = ("L", "LA", "P", "RGB", "RGBA")  # of 8 bits


def decode(content: bytes, mode: Literal["RGB", "RGBA"] = "RGB", *, most_pixels: int = _MOST_PIXELS) -> Array:
    """Decode an 8-bit PNG or JPEG picture to its stored values, shape (H, W, 3) or (H, W, 4).

    Raises:
        FileFormatError: the content is another kind of picture, has too many pixels, or is damaged; the message does
            not name the file.
    """
    from PIL import Image

    kind = kind_of(content)
    if kind is None:
        named = next((name for magic, name in _OTHERS.items() if content.startswith(magic)), "no known")
        raise FileFormatError(f"is {named} picture, expected PNG or JPEG")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures, which are refused below
            image = Image.open(io.BytesIO(content), formats=(kind,))
        with image:
            if image.width * image.height > most_pixels:
                size = f"{image.width} x {image.height}"
                raise FileFormatError(f"has {size} pixels, expected at most {most_pixels / 1e6:.2g} million")
            if image.mode not in _MODES:
                raise FileFormatError(f"has pixels of mode {image.mode}, expected RGB or grey of 8 bits")
            return np.asarray(image.convert(mode))
    except FileFormatError:  # which is a ValueError
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FileFormatError(f"cannot be decoded ({' '.join(str(error).split())[:80]})") from None


def kind_of(content: bytes) -> str | None:
    """Return "PNG" or "JPEG" from the first bytes of a picture, otherwise None."""
    return next((kind for magic, kind in _MAGIC.items() if content.startswith(magic)), None)


def tags(path: Path, kind: str) -> tuple[dict[int, Any], str]:
    """Return the TIFF and Exif tags of a picture by number, and its interoperability index, such as R98.

    `kind` is one of `KINDS`. Both are empty if the picture has no tags, or if they are damaged.
    """
    from PIL import Image

    if kind not in _TAGGED:
        return {}, ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large pictures, and of damaged tags
            with Image.open(path, formats=(kind.upper(),)) as image:
                if kind == "png" and "exif" not in image.info:  # to search, Pillow would decode the pixels
                    return {}, ""
                found = image.getexif()
                stated, index = {**found, **found.get_ifd(_EXIF)}, found.get_ifd(_INTEROPERABILITY).get(1, "")
        return stated, str(index).strip("\0 ")
    except (
        OSError,
        ValueError,
        SyntaxError,
        TypeError,
        KeyError,
        struct.error,
        Image.DecompressionBombError,
    ):
        return {}, ""
