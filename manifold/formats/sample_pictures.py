"""Pictures of a sample in a spectrophotometer's workbook: geometries by their captions, and their values."""

from __future__ import annotations

import io
import re

import numpy as np

from manifold.errors import FileFormatError
from manifold.formats.geometry_names import parse_geometry
from manifold.formats.readings import aspecular_pair
from manifold.records import Array

_DIFFUSE = re.compile(r"r?_?(\d+)d", re.IGNORECASE)  # light from everywhere: `15d`


def picture_geometry(caption: str) -> tuple[float, float] | None:
    """Angles of camera and lamp in degrees, the lamp's positive on the mirror's side, NaN for diffuse light; or None.

    >>> picture_geometry("15as-45"), picture_geometry("15as80"), picture_geometry("15d")
    ((15.0, 60.0), (15.0, -65.0), (15.0, nan))
    """
    if (diffuse := _DIFFUSE.fullmatch(caption.strip())) is not None:
        return float(diffuse[1]), np.nan
    angles = parse_geometry(caption)
    return None if angles is None or angles[2] else (angles[0], angles[0] - angles[1])


def picture_directions(camera_deg: float, lamp_deg: float) -> tuple[Array, Array]:
    """wi (3,) and wo (3,) of a picture's geometry, those of the reading of its name."""
    return aspecular_pair(camera_deg, camera_deg - lamp_deg)


def picture_values(content: bytes) -> Array:
    """Linear sRGB of a picture, shape (H, W, 3), as it is stored: the instrument's codes are linear.

    Raises:
        FileFormatError: it is neither PNG nor JPEG, or damaged.
    """
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content), formats=("PNG", "JPEG")) as image:
            return np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FileFormatError(f"cannot be decoded ({str(error)[:80]}); export the workbook again") from None
