"""Latents of a library's materials decoded at direction pairs, and new materials encoded there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.brdf.measured import values_at
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.colour.ball_colours import Picture, sums_of_runs
from manifold.directions import from_spherical
from manifold.encoding import Decoder
from manifold.mapping import MAPPINGS
from manifold.model.latent_space import LatentSpace
from manifold.model.materials import MaterialCache
from manifold.model.settings import Settings
from manifold.pairs import Pairs

REFLECTANCE_INCIDENCE_DEG = 8.0  # of integrating spheres, specular included


def integrating_sphere(incidence_deg: float = REFLECTANCE_INCIDENCE_DEG) -> Picture:
    """What an integrating sphere collects: one sum, the reflectance."""
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
    """The decoder of a space at direction pairs: of all embedding bands, or of one band.

    `names` are those of the space's materials; by default all.
    """
    mapping, cosines = MAPPINGS[settings.mapping], pairs.cosines
    rows = []
    for brdf in materials.in_bands(
        space.embedding_bands(materials.library.bands.count).tolist(), names=names
    ):
        rows.append(mapping.forward(values_at(brdf, pairs), cosines).T)  # [B_e, P]
    mapped, cosines = space.samples(np.stack(rows), cosines)
    return Decoder(space.gp, mapped, mapping, cosines)
