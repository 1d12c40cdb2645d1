"""The forward model: pixels of a photographed ball as linear functionals of its BRDF.

The ball floats in a distant environment; what its surroundings reflect onto it is left out. Pixels are averaged in
blocks, small where the picture varies. The light that each block sends to the camera is a sum over direction pairs,
half of them sampled from the light that falls on the block, half from half vectors densest around the normal; both are
weighted by the balance heuristic, so that small lamps and sharp highlights are equally well resolved.

Source: Veach & Guibas 1995, "Optimally Combining Sampling Techniques for Monte Carlo Rendering".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from manifold.directions import from_spherical, normalize, rotate_z
from manifold.estimate.blocks import Blocks
from manifold.estimate.light import Environment
from manifold.records import Array

SAMPLES = 256
"""Direction pairs of a block."""

_POWER = 4  # of the uniform variate in the elevation of half vectors

_STEPS = (
    np.array([0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101, 0.46140274])
    % 1.0
)
"""Of a sequence of low discrepancy; source: Roberts 2018, "The Unreasonable Effectiveness of Quasirandom Sequences"."""


@dataclass(frozen=True)
class Camera:
    """Where a camera that looks at the middle of the ball stands.

    Attributes:
        turn_deg: azimuth of what lies straight ahead, in the environment, from its first column to the right.
        elevation_deg: of the camera above the ball.
        distance: from the middle of the ball, in its radii.
    """

    turn_deg: float = 0.0
    elevation_deg: float = 0.0
    distance: float = np.inf

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Right, up, and towards the camera; unit vectors in a world whose +y is straight ahead."""
        e = np.deg2rad(self.elevation_deg)
        return (
            np.array([1.0, 0.0, 0.0]),
            np.array([0.0, np.sin(e), np.cos(e)]),
            np.array([0.0, -np.cos(e), np.sin(e)]),
        )

    def cylinder(self, x: Array) -> tuple[Array, Array]:
        """The same of an upright cylinder that a far, level camera sees.

        Args:
            x: right of its middle in radii, any shape, `|x| <= 1`.
        """
        right, _, towards = self.axes
        normal = x[..., None] * right + np.sqrt(np.maximum(1.0 - x * x, 0.0))[..., None] * towards
        return normal, np.broadcast_to(towards, normal.shape)

    def surface(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Normals, and directions to the camera, of points right and up of the centre, in radii of the outline.

        Args:
            x, y: any shape, `x^2 + y^2 <= 1`.
        Returns:
            Two arrays (..., 3) of unit vectors.
        """
        right, up, towards = self.axes
        flat = x[..., None] * right + y[..., None] * up
        r2 = np.minimum(x * x + y * y, 1.0)[..., None]
        if np.isinf(self.distance):
            return normalize(flat + np.sqrt(1.0 - r2) * towards), np.broadcast_to(towards, flat.shape)
        D = self.distance
        ray = normalize(flat / np.sqrt(D * D - 1.0) - towards)
        along = D * (ray @ towards)[..., None]  # negative
        t = -along - np.sqrt(np.maximum(along**2 - (D * D - 1.0), 0.0))
        return normalize(D * towards + t * ray), -ray


def direction_pairs(
    blocks: Blocks, camera: Camera, environment: Environment, samples: int = SAMPLES
) -> tuple[Array, Array, Array]:
    """Direction pairs that light blocks, and the light from there.

    Returns:
        wi towards the camera, and wo towards the light, in frames of the surface, shape (K, S, 3); radiance times
        cosine over density, in every channel, shape (K, S, C): the value of a block is the sum of light times f.
    """
    normal, view, u = sampled_surface(blocks, camera, samples)
    turn = np.deg2rad(camera.turn_deg)

    half = np.arange(samples) % 2 == 0
    m = _half_vectors(u[:, half, 1], u[:, half, 2])
    frame = frames(normal)
    wi = np.einsum("ksij,ksj->ksi", frame, view)
    mirrored = 2.0 * np.sum(wi[:, half] * m, axis=-1, keepdims=True) * m - wi[:, half]
    of_light = environment.cell_probabilities(rotate_z(normalize(normal.mean(axis=1)), -turn))
    sampled = rotate_z(environment.sample(of_light, u[:, ~half][..., [1, 2, 3]]), turn)
    wo = np.empty_like(wi)
    wo[:, half] = mirrored
    wo[:, ~half] = np.einsum("ksij,ksj->ksi", frame[:, ~half], sampled)

    world = np.einsum("ksij,ksi->ksj", frame, wo)
    radiance, pixel = environment.at(rotate_z(world, -turn))
    h = normalize(wi + wo)
    by_half = _half_density(h[..., 2]) / np.maximum(4.0 * np.abs(np.sum(wi * h, axis=-1)), 1e-9)
    density = 0.5 * samples * (by_half + environment.density(of_light, pixel))
    lit = (wo[..., 2] > 1e-6) & (wi[..., 2] > 1e-6)
    light = np.where(lit, wo[..., 2] / density, 0.0)[..., None] * radiance
    return wi, np.where(lit[..., None], normalize(wo), [0.0, 0.0, 1.0]), light


def sampled_surface(blocks: Blocks, camera: Camera, samples: int) -> tuple[Array, Array, Array]:
    """Normals and directions to the camera at points of blocks, (K, S, 3), and variates (K, S, 5).

    The first and last of these chose the points; the others are free.
    """
    K = len(blocks.starts)
    u = (np.random.default_rng(0).random((K, 1, 5)) + np.arange(samples)[:, None] * _STEPS) % 1.0
    chosen = blocks.starts[:, None] + (u[..., 0] * blocks.counts[:, None]).astype(int)
    shift = (u[..., 0] * blocks.counts[:, None]) % 1.0
    x = blocks.x[chosen] + blocks.size * (shift - 0.5)
    y = blocks.y[chosen] + blocks.size * (u[..., 4] - 0.5)
    if blocks.is_cylinder:
        return *camera.cylinder(np.clip(x, -1.0, 1.0)), u
    beyond = np.maximum(np.hypot(x, y), 1.0) * (1.0 + 1e-9)
    normal, view = camera.surface(x / beyond, y / beyond)
    return normal, view, u


def _half_vectors(u: Array, v: Array) -> Array:
    """Half vectors whose elevation grows with a power of u: dense around the normal, where mirrors reflect."""
    return from_spherical(0.5 * np.pi * u**_POWER, 2.0 * np.pi * v)


def _half_density(cos_theta_h: Array) -> Array:
    """Density of `_half_vectors` in 1/sr."""
    theta = np.maximum(np.arccos(np.clip(cos_theta_h, -1.0, 1.0)), 1e-7)
    slope = _POWER * 0.5 * np.pi * (2.0 * theta / np.pi) ** (1.0 - 1.0 / _POWER)  # of theta by u
    return np.where(theta < 0.5 * np.pi, 1.0 / (slope * np.sin(theta) * 2.0 * np.pi), 0.0)


def frames(normal: Array) -> Array:
    """Orthonormal frames (..., 3, 3) whose last row is the normal."""
    helper = np.where(np.abs(normal[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    tangent = normalize(np.cross(helper, normal))
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=-2)


def block_sums(
    values: Callable[[Array, Array], Array], wi: Array, wo: Array, light: Array, at_once: int = 16384
) -> Array:
    """Pixels of BRDFs: sums over the direction pairs of every block, shape (n, C, K).

    Args:
        values: f (n, P) of n BRDFs at direction pairs (P, 3).
        wi, wo, light: of `direction_pairs`.
    """
    K, S = light.shape[:2]
    per = max(1, at_once // S)
    parts = []
    for k in range(0, K, per):
        f = values(wi[k : k + per].reshape(-1, 3), wo[k : k + per].reshape(-1, 3))
        parts.append(np.einsum("nks,ksc->nck", f.reshape(len(f), -1, S), light[k : k + per], optimize=True))
    return np.concatenate(parts, axis=-1)
