"""Evaluates materials at the direction pairs where they are compared, and decodes latents there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import values_at
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.colour import ball_colours
from manifold.colour.ball_colours import Picture, sums_of_runs
from manifold.core.directions import from_spherical
from manifold.core.pairs import Pairs
from manifold.core.records import Array
from manifold.gp.encoding import Decoder, encoding_pairs
from manifold.model.latent_space import LatentSpace
from manifold.model.materials import MaterialCache
from manifold.model.settings import Settings
from manifold.registries import MAPPINGS

REFLECTANCE_INCIDENCE_DEG = 8.0  # incidence in integrating spheres, specular included


def integrating_sphere(incidence_deg: float = REFLECTANCE_INCIDENCE_DEG) -> Picture:
    """Return the measurement of an integrating sphere, as a picture with a single value, the reflectance."""
    wi = from_spherical(np.deg2rad(incidence_deg), 0.0)
    wo, measure = mirrored_quadrature(wi)
    return Picture(np.broadcast_to(wi, wo.shape), wo, sums_of_runs(measure * wo[:, 2], np.zeros(1, int)))


def decoder_at(
    pairs: Pairs,
    space: LatentSpace,
    materials: MaterialCache,
    settings: Settings,
    names: Sequence[str] | None = None,
) -> Decoder:
    """Return the decoder of a latent space at direction pairs, for the named materials, by default all."""
    mapping, cosines = MAPPINGS[settings.mapping], pairs.cosines
    rows = []
    for brdf in materials.in_bands(
        space.embedding_bands(materials.library.bands.count).tolist(), names=names
    ):
        rows.append(mapping.forward(values_at(brdf, pairs), cosines[:, None]).T)  # [B_e, P]
    mapped, cosines = space.samples(np.stack(rows), cosines)
    return Decoder(space.gp, mapped, mapping, cosines)


OF_BALL = slice(None, None, 7)
"""Selects every seventh direction pair of a ball."""


@cache
def appearance_pairs(is_isotropic: bool = True) -> Pairs:
    """Return the direction pairs of the encoding grid, then some pairs of a rendered ball, which are rare in the grid.

    Anisotropic materials have the same number of pairs, with the same cosines and light.
    """
    return encoding_pairs(is_isotropic) + ball_colours.ball()[OF_BALL]


def appearance_weight(samples: Array) -> Array:
    """Return factors (P,) that give cube roots (n, P) the same squared norm on the ball as on the grid."""
    grid, ball = (np.cbrt(light) for light in (encoding_pairs().cosines, ball_colours.ball().light[OF_BALL]))
    of_grid = float(np.sum((samples[:, : len(grid)] * grid) ** 2))
    of_ball = float(np.sum((samples[:, len(grid) :] * ball) ** 2))
    return np.concatenate([grid, ball * np.sqrt(of_grid / max(of_ball, np.finfo(float).tiny))])


def roots_at(materials: Sequence[BRDF], pairs: Pairs) -> Array:
    """Return the cube roots of BRDF values at direction pairs, one row per material and band, shape (N B, P)."""
    return np.concatenate([np.cbrt(np.maximum(values_at(m, pairs), 0.0)).T for m in materials])
