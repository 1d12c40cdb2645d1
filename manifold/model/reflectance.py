"""Colours of blends as reflectances.

Reflectance is the directional-hemispherical one at 8 degrees, specular included, as integrating spheres measure it;
of an RGB library, the linear sRGB colour.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from manifold.encoding import Decoder
from manifold.errors import ShapeError, UsageError
from manifold.model.blend_space import BlendSpace
from manifold.model.decoding import decoder_at, integrating_sphere
from manifold.model.latent_space import LatentSpace, fixed_colours
from manifold.model.materials import MaterialCache
from manifold.model.places import require_latent
from manifold.model.settings import Settings
from manifold.records import Array


class ReflectanceColours:
    """Turns reflectances into colour coordinates at any structure, and back."""

    def __init__(self, space: LatentSpace, materials: MaterialCache, settings: Settings) -> None:
        """Take a fitted space and the materials behind it."""
        if not isinstance(space, BlendSpace):
            raise UsageError(fixed_colours(space.kind))
        self._own, self._reflectances = space.own_colours, space.reflectances
        self._space, self._materials, self._settings = space, materials, settings

    def __repr__(self) -> str:
        return f"<ReflectanceColours: of {len(self._own)} materials>"

    def reflectance(self, name: str) -> Array:
        """Reflectance of a material, shape (B,)."""
        return self._reflectances[self._materials.index(name)].copy()

    def reached(self, x: Array, colours: Array) -> Array:
        """Reflectance of a structure x (Q,) in colours (B,), shape (B,)."""
        x = self._latent(x)
        space, decoder, measure = self._around(x)
        return space.reflectance_of(x, colours, decoder, measure)

    def like(self, x: Array, name: str) -> Array:
        """Colour coordinates (B,) that give a structure x (Q,) the reflectance of a material.

        At the material's own latent, its own colours: there the prediction is the measured file.
        """
        k, x = self._materials.index(name), self._latent(x)
        if np.array_equal(x, self._space.X[k]):
            return self._own[k].copy()
        return self.of_reflectance(x, self._reflectances[k])[0]

    def of_reflectance(self, x: Array, reflectance: Array) -> tuple[Array, Array]:
        """Colour coordinates that give a structure x (Q,) a reflectance spectrum.

        A reflectance that the structure cannot have (a metal cannot be black) is approximated.

        Args:
            x: structure.
            reflectance: shape (B,).
        Returns:
            colours (B,), and the reflectance reached, (B,).
        """
        expected = self._reflectances.shape[1:]
        reflectance = np.asarray(reflectance, dtype=np.float64)
        if reflectance.shape != expected or not np.all(np.isfinite(reflectance)):
            raise ShapeError(f"reflectance has shape {reflectance.shape}, expected {expected}, finite")
        x = self._latent(x)
        space, decoder, measure = self._around(x)
        return space.colours_of(x, reflectance, decoder, measure)

    def _latent(self, x: Array) -> Array:
        return require_latent(x, self._space.X.shape[1])

    def _around(self, x: Array) -> tuple[BlendSpace, Decoder, Array]:
        """The space, or what of it predictions at x (Q,) depend on, its decoder inside an integrating sphere, and what
        gives the reflectance when multiplied with its values, (P,).
        """
        part = self._space.around(x)
        if part is None:
            return self._space, *self._sphere
        materials, space = part
        sphere, names = integrating_sphere(), [self._materials.names[k] for k in materials]
        return space, decoder_at(sphere, space, self._materials, self._settings, names), sphere.light

    @cached_property
    def _sphere(self) -> tuple[Decoder, Array]:
        sphere = integrating_sphere()
        return decoder_at(sphere, self._space, self._materials, self._settings), sphere.light
