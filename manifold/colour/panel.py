"""Two sets of lights: those used for fitting, and the test lights in which errors are measured.

A single soft light underestimates errors, because a fit to it looks worse in other lights. Therefore fits minimise
the error of the ball in several lights, and errors are measured in five others, `judged_lights.JUDGED`: the mean over
them, and the worst light.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
import scipy

from manifold.colour import ball_colours, difference, lights
from manifold.colour.ball_colours import Picture
from manifold.colour.conversion import srgb_to_xyz
from manifold.core.directions import rotate_z
from manifold.core.judged_lights import JUDGED
from manifold.core.metrics import Errors
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands, Indices

FITTED = (
    "studio 60", "studio 180", "studio 300", "overcast", "sun 20", "sun 35", "sun 60", "sun 75", "sun 110",
)  # fmt: skip
"""Lights used for fitting: the studio turned by an angle in degrees, suns at an angle to the view, an overcast sky."""

SUN_DEG = 45.0
"""Angle in degrees between the view and the sun in pictures that show highlights."""

FITTED_SUN_PIXELS = 16
"""Pixels across the balls under suns that fits and maps compare."""

STRIDE = 4
"""Stride over the pixels of balls that still tells materials apart, and suffices for plausible errors."""

_SUN_PIXELS = 32  # across the ball


class Panel(Picture):
    """A ball in L named lights: the pixels of all lights, one light after the other."""

    def __init__(self, names: tuple[str, ...], pairs: Pairs, sums: Sequence[scipy.sparse.csr_array]) -> None:
        """Join the pixels of each light, as sums over the same pairs."""
        super().__init__(pairs.wi, pairs.wo, scipy.sparse.csr_array(scipy.sparse.vstack(sums)))
        self.names, self.counts = names, np.array([len(each.indptr) - 1 for each in sums])

    @cached_property
    def signature(self) -> int:
        """A 48-bit hash of lights, pixels and directions; calibrations with another hash are out of date.

        It hashes rounded moments, which do not depend on rounding differences between processors.
        """
        digest = hashlib.sha256(repr((self.names, self.counts.tolist())).encode())
        first = np.concatenate([[0], np.cumsum(self.counts)[:-1]])
        rows = [self.sums[a : a + n] for a, n in zip(first, self.counts, strict=True)]
        light = np.stack([np.asarray(each.sum(axis=0)).ravel() for each in rows])
        axes = np.hstack([np.ones((len(self.wi), 1)), self.wi, self.wo, self.wi**2, self.wo**2])
        digest.update((np.round(light @ axes, 6) + 0.0).tobytes())  # + 0.0: no negative zeros
        return int(digest.hexdigest()[:12], 16)

    @property
    def pixel_weights(self) -> Array:
        """Weights (K,) of all pixels, with mean 1, that give every light the same total weight."""
        return np.repeat(self.counts.mean() / self.counts, self.counts)

    def every(self, step: int) -> tuple[Panel, Indices]:
        """Return a panel of every `step`-th pixel of each light, and the indices of these pixels."""
        lights = np.split(np.arange(self.counts.sum()), np.cumsum(self.counts)[:-1])
        chosen = [light[::step] for light in lights]
        used = np.unique(self.sums[np.concatenate(chosen)].indices)
        parts = [self.sums[rows][:, used] for rows in chosen]
        return Panel(self.names, self[used], parts), np.concatenate(chosen)

    def compare(self, xyz: Array, xyz_star: Array) -> Errors[float]:
        """Return the colour differences between two balls, given their XYZ of `xyz`."""
        each = np.cumsum(self.counts)[:-1]
        found = np.split(difference.delta_e_2000(xyz, xyz_star, srgb_to_xyz(np.ones(3))), each)
        itp = np.split(difference.delta_e_itp(xyz, xyz_star), each)
        lights = {name: float(one.mean()) for name, one in zip(self.names, found, strict=True)}
        return Errors.of_lights(lights, float(np.mean([one.mean() for one in itp])))

    def errors(self, f: Array, f_star: Array, bands: Bands) -> Errors[float]:
        """Return the colour differences between the balls of BRDF values f and f_star, (P, B) each."""
        return self.compare(self.xyz(f, bands), self.xyz(f_star, bands))


@lru_cache(maxsize=8)
def panel(names: tuple[str, ...], *lit: int, sun_pixels: int = _SUN_PIXELS) -> Panel:
    """Return a panel of lights by their names, as in `FITTED` and `JUDGED`, cached and read-only.

    `lit` holds the numbers of pixels, rings and spokes of the balls in soft lights, see `ball_colours.ball`;
    `sun_pixels` is the number of pixels across the balls under suns.
    """
    white, world = ball_colours.white_ball(*lit)
    pairs, parts = white[:], list[tuple[int, scipy.sparse.csr_array]]()
    for name in names:
        kind, _, degrees = name.partition(" ")
        if kind == "sun":
            sun = ball_colours.sun_ball(float(degrees), sun_pixels)
            parts.append((len(pairs), sun.sums))
            pairs += sun
            continue
        if kind == "white":
            soft = white
        elif kind == "overcast":
            soft = white.under(ball_colours.radiance_at(lights.environment(kind), world))
        else:
            towards = rotate_z(world, np.deg2rad(float(degrees)))
            soft = white.under(ball_colours.radiance_at(ball_colours.environment(), towards))
        parts.append((0, soft.sums))
    shifted = [
        scipy.sparse.csr_array((sums.data, sums.indices + first, sums.indptr), (sums.shape[0], len(pairs)))
        for first, sums in parts
    ]
    return Panel(names, pairs, shifted)


def fitted(*lit: int, sun_pixels: int = _SUN_PIXELS) -> Panel:
    """Return the panel of the lights used for fitting."""
    return panel(FITTED, *lit, sun_pixels=sun_pixels)


@lru_cache(maxsize=1)
def fitted_pixels() -> Panel:
    """Return some pixels of the lights used for fitting, enough to compare materials."""
    return fitted(sun_pixels=FITTED_SUN_PIXELS).every(STRIDE)[0]


def sun(degrees: float) -> Picture:
    """Return the pixels of the ball under a sun `degrees` to the right of the view, at the resolution of panels."""
    return ball_colours.sun_ball(degrees, _SUN_PIXELS)


def judged() -> Panel:
    """Return the panel of the five test lights, in which errors are measured."""
    return panel(JUDGED)
