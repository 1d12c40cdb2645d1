"""Gives files and steps of walks another colour by editing their own values, without the map."""

from __future__ import annotations

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import values_at
from manifold.colour.ball_colours import Picture, sums_of_runs
from manifold.estimate.attributes import (
    COLOUR,
    COLOUR_GEOMETRY,
    Adjusted,
    Attributes,
    factor_of,
    from_lch,
    measured,
    tinted,
)
from manifold.estimate.coat import with_factor
from manifold.model.colours import ColourChoice
from manifold.model.decoding import integrating_sphere
from manifold.model.manifold import Manifold


def own_values(brdf: BRDF, attributes: Attributes) -> tuple[BRDF, Adjusted]:
    """Return a material edited to have the requested colour attributes, and the values reached."""
    asked = measured(brdf, ()) | attributes.values(brdf)
    if attributes.is_tinted:
        lab = from_lch(np.array([asked[each.key] for each in COLOUR]))
        wi, wo = COLOUR_GEOMETRY
        meter = Picture(wi[None], wo[None], sums_of_runs(np.array([np.pi]), np.zeros(1, int)))
        brdf = with_factor(brdf, tinted(factor_of(brdf), lab, brdf.bands), meter)
    return brdf, Adjusted(None, None, asked, measured(brdf, asked))


def in_colour(model: Manifold, brdf: BRDF, choice: ColourChoice) -> tuple[BRDF, str, float]:
    """Return a material edited to a given colour, a text that describes it, and the largest difference that remains."""
    if choice.like is None or choice.is_like_file:
        asked, words = choice.asked(brdf.bands)
    else:
        asked, words = model.colours.reflectance(choice.like), f"like {choice.like}"
        model.bands.require_same(brdf.bands, "the material to colour", "name a file of its bands")
    sphere = integrating_sphere()
    made = with_factor(brdf, asked, sphere)
    return made, words, float(np.abs(sphere.of(values_at(made, sphere))[0] - asked).max())
