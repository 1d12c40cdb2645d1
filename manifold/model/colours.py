"""The given colour of a prediction: the colour of a material, a reflectance spectrum, or an sRGB value."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour.reflectances import ReflectanceSpectrum, read_reflectance, srgb_reflectance
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array, Bands
from manifold.gp.encoding import Decoder
from manifold.io_rgl import read_bsdf
from manifold.library.identity import file_sha256
from manifold.model.blend_space import BlendSpace
from manifold.model.decoding import decoder_at, integrating_sphere
from manifold.model.latent_space import LatentSpace, fixed_colours
from manifold.model.materials import MaterialCache
from manifold.model.places import require_latent
from manifold.model.settings import Settings


@dataclass(frozen=True)
class ColourChoice:
    """A colour that a user gives; at most one attribute is set, and none means a blended colour (`NEAREST`).

    Attributes:
        like: name of a material of the model, or the path of a `.bsdf` file.
        reflectance: a spectrum, or the path of a text file of wavelengths in nm and reflectances.
        srgb: `#rrggbb`, or three display values from 0 to 1 with commas between.
    """

    like: str | None = None
    reflectance: Path | ReflectanceSpectrum | None = None
    srgb: str | None = None

    def __post_init__(self) -> None:
        given = [name for name, value in vars(self).items() if value is not None]
        if len(given) > 1:
            raise UsageError(f"found {' and '.join(given)}, expected only one of them")

    @property
    def is_like_file(self) -> bool:
        """Return whether the colour is taken from a `.bsdf` file."""
        return self.like is not None and self.like.endswith(".bsdf")

    def made_of(self) -> dict[str, Any]:
        """Return everything that the colour depends on as plain values, including the content of a file.

        Raises:
            MissingFileError, FileAccessError: the file is missing, or is no regular file.
        """
        spectrum, like = self.reflectance, self.like
        if self.is_like_file:
            like = file_sha256(Path(str(like)))
        if isinstance(spectrum, Path):
            known: Any = file_sha256(spectrum)
        elif spectrum is not None:
            known = [list(map(float, numbers)) for numbers in (spectrum.wavelengths_nm, spectrum.values)]
        else:
            known = None
        return {"like": like, "reflectance": known, "srgb": self.srgb}

    def asked(self, bands: Bands) -> tuple[Array, str]:
        """Return the given reflectance in these bands, shape (B,), and a text that says where it comes from."""
        if self.is_like_file:
            file = read_bsdf(Path(str(self.like)))
            bands.require_same(file.bands, str(self.like))
            sphere = integrating_sphere()
            factor = sphere.of(values_at(MeasuredBRDF(fill_unmeasured(file)), sphere))[0]
            return np.clip(factor, 0.0, 1.0), f"like {self.like}"
        if self.srgb is not None:
            return srgb_reflectance(parse_srgb(self.srgb), bands), f"sRGB {self.srgb}"
        given = self.reflectance
        assert given is not None
        spectrum = (
            given.in_bands(bands)
            if isinstance(given, ReflectanceSpectrum)
            else read_reflectance(given, bands)
        )
        return spectrum, f"by {given.name}"


NEAREST = ColourChoice()
"""No given colour: predictions have the colour blended from the surrounding materials."""


@dataclass(frozen=True, eq=False)
class ChosenColour:
    """The colour of a prediction.

    Attributes:
        colours: colour coordinate of every band, shape (B,); None if the latent determines the colour.
        words: text that says where the colour comes from; None if the latent determines it.
        residual: largest difference, over the bands, between the given and the reached reflectance.
    """

    colours: Array | None
    words: str | None
    residual: float


UNCHOSEN = ChosenColour(None, None, 0.0)
"""The absence of a given colour: the latent determines the colour."""


def parse_srgb(text: str) -> Array:
    """Parse `#rrggbb` or `r,g,b` into encoded sRGB values in [0, 1], shape (3,)."""
    digits = text.removeprefix("#")
    try:
        if "," in text:
            values = [float(part) for part in text.split(",")]
        elif re.fullmatch("[0-9a-fA-F]{6}", digits):
            values = [int(digits[k : k + 2], 16) / 255.0 for k in (0, 2, 4)]
        else:
            raise ValueError
        if len(values) != 3 or not all(0.0 <= v <= 1.0 for v in values):
            raise ValueError
    except ValueError:
        raise UsageError(
            f"sRGB '{text}': expected #rrggbb, or three values from 0 to 1 like 0.8,0.5,0.2"
        ) from None
    return np.array(values)


class ReflectanceColours:
    """Converts between reflectances and colour coordinates at any latent."""

    def __init__(self, space: LatentSpace, materials: MaterialCache, settings: Settings) -> None:
        """Take a fitted space and the materials behind it."""
        if not isinstance(space, BlendSpace):
            raise UsageError(fixed_colours(space.kind))
        self._own, self._reflectances = space.own_colours, space.reflectances
        self._space, self._materials, self._settings = space, materials, settings

    def __repr__(self) -> str:
        return f"<ReflectanceColours: of {len(self._own)} materials>"

    def reflectance(self, name: str) -> Array:
        """Return the reflectance of a material, shape (B,)."""
        return self._reflectances[self._materials.index(name)].copy()

    def reached(self, x: Array, colours: Array) -> Array:
        """Return the reflectance (B,) of the prediction at a latent x (Q,) with colour coordinates (B,)."""
        x = self._latent(x)
        space, decoder, measure = self._around(x)
        return space.reflectance_of(x, colours, decoder, measure)

    def like(self, x: Array, name: str) -> Array:
        """Return the colour coordinates (B,) that give the prediction at a latent x (Q,) the reflectance of a material.

        At the material's own latent they are its own colours, so that the prediction there is the measured file.
        """
        k, x = self._materials.index(name), self._latent(x)
        if np.array_equal(x, self._space.X[k]):
            return self._own[k].copy()
        return self.of_reflectance(x, self._reflectances[k])[0]

    def of_reflectance(self, x: Array, reflectance: Array) -> tuple[Array, Array]:
        """Return the colour coordinates (B,) for a reflectance (B,) at x (Q,), and the reflectance reached (B,).

        A reflectance that a prediction cannot reach is approximated; a metal, for example, cannot be black.
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
        """Return the space on which predictions at x (Q,) depend, and its decoder inside an integrating sphere.

        The third value, (P,), gives the reflectance when multiplied with the decoder's values.
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
