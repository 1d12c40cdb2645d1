"""Computes the colours of a material's ball in studio light by quadrature, a fast substitute for rendering.

The ball floats in the studio of `manifold.colour.lights`, with the light of the floor from below, and is seen from
far away. Each pixel shows one point of the ball, at which the incident light is summed over half vectors. These are
densest around the normal, so that sharp highlights are resolved as well as soft ones. BRDFs are evaluated at fixed
direction pairs.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
import scipy

from manifold.colour import lights
from manifold.colour.conversion import srgb_to_xyz, to_xyz, xyz_to_srgb
from manifold.colour.difference import delta_e_2000
from manifold.core.directions import from_spherical, normalize, rotate_z
from manifold.core.pairs import GOLDEN, Pairs
from manifold.core.records import Array, Bands, Indices

VIEW = normalize(np.array([0.0, -8.2, 2.3]))
"""The direction from the ball to the viewer."""

DRAWN = 32, 32
"""Rings and spokes of drawn balls. Of 255 codes, matt ones err by 2 at the 95th percentile (24 x 16: by 10)."""

_PIXELS, _RINGS, _SPOKES = 10, 18, 12
_ENVIRONMENT_ROWS, _BLUR = 20, 12
_BLOCK = 128  # pixels whose pairs are made at once: arrays of all pairs of a fine ball take gigabytes


def environment() -> Array:
    """Return the light of the studio and, from below, of its floor, in coarse cells that soften edges.

    The result is radiance, float32, in the layout of `lights.studio`, shape (20, 40, 3).
    """
    fine = lights.studio(_ENVIRONMENT_ROWS * _BLUR)
    image: Array = fine.reshape(_ENVIRONMENT_ROWS, _BLUR, 2 * _ENVIRONMENT_ROWS, _BLUR, 3).mean(axis=(1, 3))
    image[_ENVIRONMENT_ROWS // 2 :] = lights.FLOOR_REFLECTANCE
    return image


class Picture(Pairs):
    """Weighted sums of BRDF values over direction pairs: pixels of a lit ball, or values of an instrument.

    For balls, wi points towards the viewer and wo towards the light, in the local frame of the surface.

    Attributes:
        sums: weights of the values at P pairs in each of K sums, sparse, shape (K, P); for pixels, radiance times
            cosine times solid angle.
        places: position of each pixel, right and up, in radii of the ball, shape (K, 2); empty for other sums.
    """

    def __init__(
        self, wi: Array, wo: Array, sums: scipy.sparse.csr_array, places: Array | None = None
    ) -> None:
        super().__init__(wi, wo)
        self.sums, self.places = sums, np.empty((0, 2)) if places is None else places

    def of(self, f: Array) -> Array:
        """Return the sums of values f (P, ...), shape (K, ...)."""
        return np.asarray(self.sums @ f.reshape(len(f), -1)).reshape(-1, *f.shape[1:])

    def mean(self, f: Array) -> Array:
        """Return the weighted means of values f (P, ...), shape (K, ...)."""
        totals = self.of(np.ones(len(f)))
        return self.of(f) / totals.reshape(-1, *(1,) * (f.ndim - 1))

    @cached_property
    def light(self) -> Array:
        """The total weight of every pair over all sums, shape (P,)."""
        return np.asarray(self.sums.sum(axis=0))

    def xyz(self, f: Array, bands: Bands) -> Array:
        """Return the CIE XYZ values (K, 3) under D65 of pixels on a display, from BRDF values f (P, B) in 1/sr.

        Colours are clipped to the range of linear sRGB, as in a picture without tone mapping.
        """
        linear = xyz_to_srgb(self.of(to_xyz(f, bands)), to_xyz(np.ones(bands.count), bands))
        return srgb_to_xyz(np.clip(linear, 0.0, 1.0))

    def difference(self, f: Array, f_star: Array, bands: Bands) -> float:
        """Return the mean CIEDE2000 between the balls of two materials, given their BRDF values as for `xyz`."""
        return delta_e(self.xyz(f, bands), self.xyz(f_star, bands))

    def under(self, radiance: Array) -> Picture:
        """Return this picture under white light with another radiance (P,) along wo."""
        sums = self.sums.copy()
        sums.data *= radiance[sums.indices]
        return Picture(self.wi, self.wo, sums, self.places)

    def of_pixels(self, pixels: slice) -> Picture:
        """Return a picture of some of the pixels, with the direction pairs that light them.

        The pairs of a ball are sorted by pixel.
        """
        sums = self.sums[pixels]
        first, end = int(sums.indices.min()), int(sums.indices.max()) + 1
        own = scipy.sparse.csr_array(
            (sums.data, sums.indices - first, sums.indptr), shape=(sums.shape[0], end - first)
        )
        return Picture(self.wi[first:end], self.wo[first:end], own, self.places[pixels])


def delta_e(xyz: Array, xyz_star: Array) -> float:
    """Return the mean CIEDE2000 between two balls, XYZ (K, 3) each."""
    return float(np.mean(delta_e_2000(xyz, xyz_star, srgb_to_xyz(np.ones(3)))))


def sums_of_runs(weights: Array, starts: Indices) -> scipy.sparse.csr_array:
    """Return a matrix (K, P) that sums weighted values over K runs of pairs, given the weights (P,) and starts (K,)."""
    P = len(weights)
    return scipy.sparse.csr_array((weights, np.arange(P), np.append(starts, P)), shape=(len(starts), P))


@lru_cache(maxsize=8)
def ball(
    pixels: int = _PIXELS, rings: int = _RINGS, spokes: int = _SPOKES, *, turned_deg: float = 0.0
) -> Picture:
    """Return a ball in a square of `pixels`^2 pixels, each lit by at most rings * spokes half vectors.

    The result is cached and read-only. `turned_deg` turns the studio about the vertical; at 180 degrees its key light
    is behind the ball.
    """
    white, world = white_ball(pixels, rings, spokes)
    return white.under(radiance_at(environment(), rotate_z(world, np.deg2rad(turned_deg))))


@lru_cache(maxsize=8)
def white_ball(pixels: int = _PIXELS, rings: int = _RINGS, spokes: int = _SPOKES) -> tuple[Picture, Array]:
    """Return `ball` under radiance 1 from all directions, and wo in world directions (P, 3), both read-only."""
    x, y, frame = frames(pixels)
    u = (np.arange(rings) + 0.5) / rings
    theta = np.repeat(0.5 * np.pi * u * u, spokes)
    turn = (np.arange(spokes) + 0.5)[None] / spokes + GOLDEN * np.arange(rings)[:, None]
    m = from_spherical(theta, 2.0 * np.pi * turn.ravel())  # [M, 3]
    area = np.sin(theta) * np.pi * np.repeat(u, spokes) / rings * 2.0 * np.pi / spokes
    wi = frame @ VIEW

    def lit_pairs(first: int) -> tuple[Indices, Array, Array, Array]:
        """Return pixel, wo, the world's directions of wo and weight of the lit pairs of some pixels."""
        some = slice(first, first + _BLOCK)
        cosine = wi[some] @ m.T  # [K', M]
        wo = 2.0 * cosine[..., None] * m - wi[some, None]
        lit = (cosine > 0.0) & (wo[..., 2] > 0.0)
        world = np.einsum("kmc,kcw->kmw", wo, frame[some])[lit]
        wo = wo[lit]
        return first + np.nonzero(lit)[0], normalize(wo), world, wo[:, 2] * (4.0 * cosine * area)[lit]

    blocks = zip(*map(lit_pairs, range(0, len(wi), _BLOCK)), strict=True)
    pixel, wo, world, weight = (np.concatenate(parts) for parts in blocks)
    starts = np.searchsorted(pixel, np.arange(len(wi)))
    return Picture(wi[pixel], wo, sums_of_runs(weight, starts), np.column_stack([x, y])), world


def frames(pixels: int) -> tuple[Array, Array, Array]:
    """Return the positions right and up (K,) of a ball's pixels, and the local frames there (K, 3, 3), as rows."""
    right = normalize(np.cross([0.0, 0.0, 1.0], VIEW))
    up = np.cross(VIEW, right)
    across = 2.0 * (np.arange(pixels) + 0.5) / pixels - 1.0
    x, y = (a.ravel() for a in np.meshgrid(across, -across))
    inside = x * x + y * y < 1.0
    x, y = x[inside], y[inside]
    depth = np.sqrt(1.0 - x * x - y * y)
    normal = x[:, None] * right + y[:, None] * up + depth[:, None] * VIEW
    tangent = normalize(np.cross(up, normal))
    return x, y, np.stack([tangent, np.cross(normal, tangent), normal], axis=1)


@lru_cache(maxsize=32)
def sun_ball(degrees: float, pixels: int) -> Picture:
    """Return the lit pixels of a ball under a distant lamp, one direction pair each.

    The ball is `pixels` wide. A white diffuser that faces the lamp has radiance 1. The lamp is `degrees` to the right
    of the view; above 90 it is behind the ball. The result is cached: do not write to it.
    """
    x, y, frame = frames(pixels)
    right = normalize(np.cross([0.0, 0.0, 1.0], VIEW))
    lamp = np.cos(np.deg2rad(degrees)) * VIEW + np.sin(np.deg2rad(degrees)) * right
    lit = frame[:, 2] @ lamp > 0.0
    wi, wo = frame[lit] @ VIEW, frame[lit] @ lamp
    sums = sums_of_runs(np.pi * wo[:, 2], np.arange(len(wi)))
    return Picture(wi, wo, sums, np.column_stack([x, y])[lit])


def radiance_at(image: Array, directions: Array) -> Array:
    """Return the bilinearly interpolated radiance (M,) of a colourless environment from world directions (M, 3)."""
    rows, columns = image.shape[:2]
    elevation = np.arccos(np.clip(directions[:, 2], -1.0, 1.0)) / np.pi * rows - 0.5
    azimuth = np.arctan2(directions[:, 0], directions[:, 1]) / (2.0 * np.pi) * columns - 0.5
    i, j = np.floor(elevation).astype(int), np.floor(azimuth).astype(int)
    s, t = elevation - i, azimuth - j
    above, below = np.clip(i, 0, rows - 1), np.clip(i + 1, 0, rows - 1)
    grey = image[..., 0].astype(float)
    before, after = j % columns, (j + 1) % columns
    upper = (1 - t) * grey[above, before] + t * grey[above, after]
    lower = (1 - t) * grey[below, before] + t * grey[below, after]
    return np.asarray((1 - s) * upper + s * lower)
