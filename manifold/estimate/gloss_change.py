"""Another coat on a material: its gloss is changed, and what lies below stays as it is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from manifold.analytic.microfacet import Plastic
from manifold.brdf.measured import BRDF
from manifold.brdf.wrapped import WrappedBRDF
from manifold.colour.conversion import luminance
from manifold.estimate.attributes import factor_of, lab_of, lab_of_factor
from manifold.estimate.coat import COLOUR_ROUNDING, coat_of, gloss_misfits, nearest_coat
from manifold.estimate.gloss import gloss_meter, gloss_units
from manifold.records import Array

_DARK = 1e-9  # in 1/sr


class RecoatedBRDF(WrappedBRDF):
    """A BRDF whose coat is exchanged for another, see `exchanged`."""

    def __init__(self, brdf: BRDF, old: Plastic, new: Plastic, strength: Array):
        """Exchange a coat.

        Args:
            brdf: the material.
            old, new: coats over a Lambertian, in its bands.
            strength: of the material's highlight against that of the old coat, shape (B,).
        """
        super().__init__(brdf)
        self._old, self._new, self._strength = old, new, strength

    def eval(self, wi: Array, wo: Array) -> Array:
        """f in 1/sr, shape (..., B)."""
        f = np.maximum(self._brdf.eval(wi, wo), 0.0)
        return exchanged(f, _parts(self._old, wi, wo), _parts(self._new, wi, wo), self._strength)


def _parts(coat: Plastic, wi: Array, wo: Array) -> tuple[Array, Array]:
    """What the surface of a coat reflects and what comes from below it, in 1/sr, each (..., B)."""
    surface = coat.boundary.eval(wi, wo)
    return surface, coat.eval(wi, wo) - surface


def exchanged(f: Array, old: tuple[Array, Array], new: tuple[Array, Array], strength: Array) -> Array:
    """Values of a material with a new coat instead of an old one, in 1/sr, shape (..., B).

    What the old coat's base explains of them changes as the base does. The rest, the highlight, changes as the surface
    does: it is taken away in proportion, and added as strongly as the material's highlight is to the old coat's, so
    that a metal's stays coloured.

    Args:
        f: the values, at least 0.
        old, new: of the coats, see `_parts`.
        strength: the largest ratio of the highlights, at least 1, shape (B,).
    """
    (surface, base), (new_surface, new_base) = old, new
    below = np.minimum(f, base)
    ratio = (f - below) / np.maximum(surface, _DARK)
    ratio = np.where(new_surface > surface, np.clip(ratio, 1.0, strength), ratio)
    return np.asarray(
        f - below + ratio * (new_surface - surface) + below * new_base / np.maximum(base, _DARK)
    )


def with_gloss(brdf: BRDF, gloss: Mapping[float, float]) -> RecoatedBRDF:
    """A material with another coat, which gives it the gloss that is asked for and keeps its colour at 45/0.

    The present coat is the one over a Lambertian that has the material's gloss at 20, 60 and 85 degrees.

    Args:
        brdf: the material.
        gloss: gloss units by angle in degrees, one at least, above 0.
    Raises:
        UsageError: gloss meters have no such angle.
    """
    bands, meters = brdf.bands, [gloss_meter(angle) for angle in gloss]
    old, _ = coat_of(lab_of(brdf), gloss_units(brdf), bands)
    values = [(np.maximum(brdf.eval(m.wi, m.wo), 0.0), _parts(old, m.wi, m.wo)) for m in meters]
    highlights = [
        m.mean(np.maximum(f - base, 0.0)) / m.mean(surface)
        for m, (f, (surface, base)) in zip(meters, values, strict=True)
    ]
    strength = np.maximum(np.mean(highlights, axis=0), 1.0)
    colour, factor, of_old = lab_of(brdf), factor_of(brdf), _factors(old)

    def off(new: Plastic) -> Array:
        made = [
            m.units(luminance(exchanged(f, parts, _parts(new, m.wi, m.wo), strength), bands))
            for m, (f, parts) in zip(meters, values, strict=True)
        ]
        seen = lab_of_factor(exchanged(factor, of_old, _factors(new), strength), bands)
        return np.append(gloss_misfits(np.array(made), gloss), (seen - colour) / COLOUR_ROUNDING)

    new, _ = nearest_coat(factor_of(old), bands, off, float(np.mean(old.eta)))
    return RecoatedBRDF(brdf, old, new, strength)


def _factors(coat: Plastic) -> tuple[Array, Array]:
    surface = factor_of(coat.boundary)
    return surface, factor_of(coat) - surface
