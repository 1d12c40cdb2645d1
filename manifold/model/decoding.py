"""Latents of a library's materials decoded at direction pairs, and new materials encoded there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.directions import from_spherical
from manifold.encoding import Decoder, EncodingPairs
from manifold.mapping import mapping_named
from manifold.model.latent_space import LatentSpace
from manifold.model.materials import MaterialCache
from manifold.model.settings import Settings
from manifold.records import Array

REFLECTANCE_INCIDENCE_DEG = 8.0  # of integrating spheres, specular included


def integrating_sphere(incidence_deg: float = REFLECTANCE_INCIDENCE_DEG) -> tuple[EncodingPairs, Array]:
    """Direction pairs of an integrating sphere, and weights (P,) whose product with f there is the reflectance."""
    wi = from_spherical(np.deg2rad(incidence_deg), 0.0)
    wo, measure = mirrored_quadrature(wi)
    return EncodingPairs(np.broadcast_to(wi, wo.shape), wo), measure * wo[:, 2]


def decoder_at(
    pairs: EncodingPairs,
    space: LatentSpace,
    materials: MaterialCache,
    settings: Settings,
    names: Sequence[str] | None = None,
) -> Decoder:
    """The decoder of a space at direction pairs: of all embedding bands, or of one band.

    `names` are those of the space's materials; by default all.
    """
    mapping, cosines = mapping_named(settings.mapping), pairs.cosines
    located = DirectionPairs(pairs.wi, pairs.wo)
    rows = []
    for brdf in materials.in_bands(
        space.embedding_bands(materials.library.bands.count).tolist(), names=names
    ):
        rows.append(mapping.forward(brdf.eval_at(located), cosines).T)  # [B_e, P]
    mapped, cosines = space.samples(np.stack(rows), cosines)
    return Decoder(space.gp, mapped, mapping, cosines)
