"""Image differences: CIEDE2000 and Delta E_ITP per pixel, and FLIP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manifold.colour.conversion import decode_srgb, srgb_to_xyz
from manifold.colour.difference import delta_e_2000, delta_e_itp
from manifold.errors import ShapeError
from manifold.records import Array

PIXELS_PER_DEGREE = 67.0
"""Of a viewer 0.7 m from a 0.7 m wide display with 3840 columns."""

_WHITE = np.array([1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Summary:
    """Statistics of a map of differences."""

    mean: float
    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, values: Array) -> Summary:
        """Of all values of an array."""
        return cls(
            float(np.mean(values)),
            float(np.median(values)),
            float(np.quantile(values, 0.95)),
            float(np.max(values)),
        )


def ciede2000_map(display: Array, other: Array) -> Array:
    """CIEDE2000 between display values in [0, 1], shapes (H, W, 3), relative to the display's white; shape (H, W)."""
    require_pictures(display, other)
    xyz, xyz_other = (srgb_to_xyz(decode_srgb(np.clip(p, 0.0, 1.0))) for p in (display, other))
    return delta_e_2000(xyz, xyz_other, srgb_to_xyz(_WHITE))


def itp_map(display: Array, other: Array) -> Array:
    """Delta E_ITP between display values in [0, 1], shapes (H, W, 3); shape (H, W)."""
    require_pictures(display, other)
    return delta_e_itp(*(srgb_to_xyz(decode_srgb(np.clip(p, 0.0, 1.0))) for p in (display, other)))


def flip_map(reference: Array, test: Array, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Array:
    """FLIP between display values in [0, 1], shapes (H, W, 3): 0 alike to 1 as different as can be, shape (H, W).

    Raises:
        ShapeError: the pictures do not have the same size, or no three channels.
    Source: Andersson et al. 2020, DOI 10.1145/3406183; its authors' program, for a low dynamic range.
    """
    from flip_evaluator import evaluate  # which pictures that are not compared do without

    require_pictures(reference, test)
    pictures = (np.clip(p, 0.0, 1.0).astype(np.float32) for p in (reference, test))
    found, _, _ = evaluate(*pictures, "LDR", applyMagma=False, parameters={"ppd": pixels_per_degree})
    return np.asarray(found[..., 0], dtype=np.float64)


def require_pictures(a: Array, b: Array) -> None:
    """Raise ShapeError unless two pictures have the same size and three channels."""
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3:
        raise ShapeError(
            f"pictures have shapes {a.shape} and {b.shape}, expected the same (height, width, 3); render both alike"
        )
