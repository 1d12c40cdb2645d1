"""Sparkle: points that light up under one lamp and not under the next, as flakes in a paint do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label, maximum_filter, uniform_filter

from manifold.records import Array
from manifold.surface.estimate import Surface

_PER = 1e4  # pixels that densities are counted by
_LARGEST_GLINT_PX = 40.0  # area; what is larger is relief, or dust
_WIDEST_DEG = 60.0


@dataclass(frozen=True)
class Sparkle:
    """Statistics of the glints of a surface; densities are per 10,000 pixels and lamp.

    Attributes:
        density: glints, in the mean over lamps within 50 degrees of the normal.
        size_px: their area in pixels, median; 0 where there are none.
        brightness: their brightest pixel over the surroundings, median; 1 where there are none.
        seen_once: share of them that no other lamp shows.
        spread_deg: standard deviation of the tilt of flakes that would give densities as seen, at most 60; None where
            fewer than three lamps show any.
    """

    density: float
    size_px: float
    brightness: float
    seen_once: float
    spread_deg: float | None

    def to_json(self) -> dict[str, float | None]:
        """Plain values."""
        return dict(vars(self))


def sparkle_of(surface: Surface) -> Sparkle:
    """Count the glints of a surface, lamp by lamp."""
    pictures = surface.pictures
    lamps = [j for j in range(len(pictures.labels)) if surface.glints[j].any()]
    looked_at = int(np.sum(np.nan_to_num(pictures.lamps[:, 2]) > np.cos(np.deg2rad(50.0))))
    sizes, brightness, once, counts = [], [], [], {}
    near = {j: maximum_filter(surface.glints[j], 3) for j in lamps}
    for j in lamps:
        labels, count = label(surface.glints[j], structure=np.ones((3, 3)))
        area = np.bincount(labels.ravel())[1:]
        kept = np.flatnonzero(area <= _LARGEST_GLINT_PX) + 1
        counts[j] = len(kept)
        grey = pictures.values[j].mean(axis=-1)
        relative = grey / uniform_filter(grey, 15, mode="nearest")
        peaks = np.zeros(count + 1)
        np.maximum.at(peaks, labels.ravel(), relative.ravel())
        elsewhere = np.zeros(count + 1)
        np.maximum.at(
            elsewhere, labels.ravel(),
            np.any([near[k] for k in lamps if k != j] or [np.zeros_like(near[j])], axis=0).ravel(),
        )  # fmt: skip
        sizes += area[kept - 1].tolist()
        brightness += peaks[kept].tolist()
        once += (elsewhere[kept] == 0.0).tolist()
    total = sum(counts.values())
    pixels = surface.third.size
    return Sparkle(
        density=_PER * total / pixels / max(looked_at, 1),
        size_px=float(np.median(sizes)) if total else 0.0,
        brightness=float(np.median(brightness)) if total else 1.0,
        seen_once=float(np.mean(once)) if total else 0.0,
        spread_deg=_spread(pictures.lamps, counts),
    )


def _spread(lamps: Array, counts: dict[int, int]) -> float | None:
    """Standard deviation of a normal distribution of tilts, from how the counts fall with the half vector's angle."""
    seen = [j for j, count in counts.items() if count > 0]
    if len(seen) < 3:
        return None
    camera = np.array([0.0, np.sin(np.deg2rad(15.0)), np.cos(np.deg2rad(15.0))])
    half = lamps[seen] + camera
    tilt = np.arccos(half[:, 2] / np.linalg.norm(half, axis=-1))
    logs = np.log([counts[j] for j in seen])
    weights = np.sqrt([counts[j] for j in seen])
    slope = np.polyfit(tilt**2, logs, 1, w=weights)[0]
    return float(min(np.rad2deg(np.sqrt(-0.5 / slope)) if slope < 0.0 else _WIDEST_DEG, _WIDEST_DEG))
