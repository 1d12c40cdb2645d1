"""The panel of lights in which the look of a material is fitted, and those in which it is judged.

One soft light flatters: what is fitted to it looks worse elsewhere. So fits see the ball in several lights, and errors
are of other ones: means over these, and the worst of them by its name. Which is which is said here, and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from manifold.colour import ball_colours, difference, lights
from manifold.colour.ball_colours import Ball
from manifold.colour.conversion import srgb_to_xyz
from manifold.directions import rotate_z
from manifold.records import Array, Bands

FITTED = (
    "studio 60", "studio 180", "studio 300", "overcast", "sun 20", "sun 35", "sun 60", "sun 75", "sun 110",
)  # fmt: skip
"""What fits see: the studio turned by so many degrees, suns so many degrees beside the view, an overcast sky."""

JUDGED = ("studio 0", "white", "sun 45", "sun 80", "sun 130")
"""What errors are measured in, and no fit sees: the studio, the same light from everywhere, suns."""

_SUN_PIXELS = 32  # across the ball


@dataclass(frozen=True)
class LookErrors:
    """How differently two balls look.

    Attributes:
        lights: mean CIEDE2000 over the ball's pixels, by the name of the light.
        ball_itp: mean Delta E_ITP, over pixels and lights.
    """

    lights: dict[str, float]
    ball_itp: float

    @property
    def ball(self) -> float:
        """CIEDE2000, mean over the lights."""
        return sum(self.lights.values()) / len(self.lights)

    @property
    def worst_light(self) -> str:
        """The light of the largest CIEDE2000."""
        return max(self.lights, key=self.lights.__getitem__)

    @property
    def worst(self) -> float:
        """CIEDE2000 in this light."""
        return self.lights[self.worst_light]

    def __str__(self) -> str:
        return f"{self.ball:.2f} in the mean of {len(self.lights)} lights, {self.worst:.2f} in {self.worst_light}"

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "ball": self.ball, "worst": self.worst, "worst_light": self.worst_light, "ball_itp": self.ball_itp,
            "lights": self.lights,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Panel:
    """A ball in several lights, whose pixels are sums over one table of direction pairs.

    Attributes:
        names: of the L lights.
        balls: the ball in each.
        wi, wo: all direction pairs, unit vectors (P, 3).
        parts: where those of each ball stand in the table.
    """

    names: tuple[str, ...]
    balls: tuple[Ball, ...]
    wi: Array
    wo: Array
    parts: tuple[slice, ...]

    @property
    def pixel_weights(self) -> Array:
        """Weights (K,) of all pixels with which lights count the same, whose mean is 1."""
        counts = np.array([len(ball.starts) for ball in self.balls])
        return np.repeat(counts.mean() / counts, counts)

    def pixels(self, f: Array) -> Array:
        """Radiance (..., K) of the pixels of all lights, one after the other, of values f (..., P) in 1/sr."""
        return np.concatenate(
            [
                np.add.reduceat(f[..., part] * ball.light, ball.starts, axis=-1)
                for ball, part in zip(self.balls, self.parts, strict=True)
            ],
            axis=-1,
        )

    def xyz(self, f: Array, bands: Bands) -> Array:
        """CIE XYZ (K, 3) of the pixels of all lights, see `Ball.xyz`, of values f (P, B)."""
        return np.concatenate(
            [ball.xyz(f[part], bands) for ball, part in zip(self.balls, self.parts, strict=True)]
        )

    def compare(self, xyz: Array, xyz_star: Array) -> LookErrors:
        """How differently two balls look, by what `xyz` returns."""
        each = np.cumsum([len(ball.starts) for ball in self.balls])[:-1]
        found = np.split(difference.delta_e_2000(xyz, xyz_star, srgb_to_xyz(np.ones(3))), each)
        itp = np.split(difference.delta_e_itp(xyz, xyz_star), each)
        lights = {name: float(one.mean()) for name, one in zip(self.names, found, strict=True)}
        return LookErrors(lights, float(np.mean([one.mean() for one in itp])))

    def errors(self, f: Array, f_star: Array, bands: Bands) -> LookErrors:
        """How differently the balls of values f and f_star (P, B) look."""
        return self.compare(self.xyz(f, bands), self.xyz(f_star, bands))


@lru_cache(maxsize=8)
def panel(names: tuple[str, ...], *lit: int, sun_pixels: int = _SUN_PIXELS) -> Panel:
    """A panel of lights by their names; cached: do not write to it.

    Args:
        names: as in `FITTED` and `JUDGED`.
        lit: pixels, rings and spokes of the balls in soft lights, as in `ball_colours.ball`.
        sun_pixels: across the balls under suns.
    """
    soft = ball_colours.lit_ball(*lit)
    balls, parts, end = [], [], len(soft.wi)
    for name in names:
        kind, _, degrees = name.partition(" ")
        if kind == "sun":
            balls.append(ball_colours.sun_ball(float(degrees), sun_pixels))
            parts.append(slice(end, end := end + len(balls[-1].wi)))
            continue
        radiance: Array
        if kind == "white":
            radiance = np.ones(len(soft.world))
        elif kind == "overcast":
            radiance = ball_colours.radiance_at(lights.environment(kind), soft.world)
        else:
            world = rotate_z(soft.world, np.deg2rad(float(degrees)))
            radiance = ball_colours.radiance_at(ball_colours.environment(), world)
        balls.append(soft.under(radiance))
        parts.append(slice(0, len(soft.wi)))
    suns = [ball for ball, part in zip(balls, parts, strict=True) if part.start]
    wi, wo = (np.concatenate([getattr(one, key) for one in (soft, *suns)]) for key in ("wi", "wo"))
    return Panel(names, tuple(balls), wi, wo, tuple(parts))


def fitted(*lit: int, sun_pixels: int = _SUN_PIXELS) -> Panel:
    """The panel that fits see."""
    return panel(FITTED, *lit, sun_pixels=sun_pixels)


def judged() -> Panel:
    """The panel that errors are measured in."""
    return panel(JUDGED)
