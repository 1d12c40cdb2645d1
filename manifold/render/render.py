"""Renders the material ball in Mitsuba; importing this module registers the BSDF plugin `manifold`.

Spectral scenes are rendered with a colorimetric film. The scene does not contain the illuminant; the film's three
channels weight the arriving light by the illuminant and by the colour matching functions. Therefore one scene can be
rendered under all illuminants, and the emission lines of fluorescent lamps are sampled. The white of the illuminant
is adapted to the white of sRGB.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from manifold.colour.conversion import sensor_responses, xyz_to_srgb
from manifold.colour.illuminants import Illuminant
from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.records import Array
from manifold.render import backend, measured_plugin, scenes
from manifold.render.plugin.bsdf import register

LARGEST_SIZE = 8192
_WINDOW = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
_LANES = 1 << 23  # samples rendered at once: the sampler stratifies those of one pass among each other

backend.on_variant(register)


@dataclass(frozen=True)
class RenderSettings:
    """Settings of a render: size, samples per pixel, light.

    Attributes:
        size: pixels per side.
        samples: light paths per pixel.
        seed: seed of the noise; equal seeds give equal pictures, up to the order in which threads add samples.
        environment: linear RGB radiance (H, W, 3) in the layout of `lights.studio`, which is the default.
        window: the part of the picture that is rendered, as left, top, width and height in pixels; all of it if None.
    """

    size: int = 256
    samples: int = 64
    seed: int = 0
    illuminant: Illuminant = field(default_factory=partial(Illuminant.named, "D65"))
    environment: Array | None = None
    window: tuple[int, int, int, int] | None = None

    @property
    def light(self) -> str:
        """The name of the light, for texts beside errors of pictures."""
        around = "studio" if self.environment is None else "the environment map"
        return f"{around}, {self.illuminant.name}"

    def __post_init__(self) -> None:
        for name, most in (("size", LARGEST_SIZE), ("samples", 1 << 20)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or not 1 <= value <= most:
                raise UsageError(f"{name} is {value}, expected an integer from 1 to {most}")
        if self.seed < 0:
            raise UsageError(f"seed is {self.seed}, expected 0 or more")


@backend.variant_kept()
def render_bsdf(
    bsdf: Mapping[str, Any],
    is_rgb: bool,
    settings: RenderSettings,
) -> Array:
    """Render the ball of a material, given as a Mitsuba dictionary, in linear sRGB, shape (size, size, 3).

    With a window in the settings, the result has the window's shape. Materials without a spectrum (`is_rgb`) can only
    be rendered under D65.
    """
    window = {} if settings.window is None else dict(zip(_WINDOW, settings.window, strict=True))
    if is_rgb:
        require_d65(settings.illuminant)
        mi = backend.mitsuba("rgb")
        film = rgb_film(settings.size) | window
        scene = mi.load_dict(
            scenes.material_ball(mi, measured_plugin.load_bsdf(mi, bsdf), film, settings.environment)
        )
        return render_scene(mi, scene, settings)
    mi = backend.mitsuba("spectral")
    film = colorimetric_film(mi, settings.size, settings.illuminant) | window
    scene = mi.load_dict(
        scenes.material_ball(mi, measured_plugin.load_bsdf(mi, bsdf), film, settings.environment)
    )
    xyz = render_scene(mi, scene, settings)
    return xyz_to_srgb(xyz, sensor_responses(settings.illuminant)[1].sum(axis=0))


@backend.variant_kept()
def render_floating_ball(
    path: Path,
    is_rgb: bool,
    environment: Array,
    *,
    size: int,
    samples: int,
    **view: float,
) -> Array:
    """Render a measured file on a ball alone in an environment under D65, in linear sRGB, shape (size, size, 3).

    The environment (H, W, 3) has the layout of `lights.studio`; `view` holds arguments of `scenes.floating_ball`.
    """
    settings, bsdf = RenderSettings(size, samples), {"type": "measured", "filename": str(path)}
    mi = backend.mitsuba("rgb" if is_rgb else "spectral")
    film = rgb_film(size) if is_rgb else colorimetric_film(mi, size, settings.illuminant)
    loaded = measured_plugin.load_bsdf(mi, bsdf)
    scene = mi.load_dict(scenes.floating_ball(mi, loaded, film, environment, **view))
    picture = render_scene(mi, scene, settings)
    return picture if is_rgb else xyz_to_srgb(picture, sensor_responses(settings.illuminant)[1].sum(axis=0))


def require_d65(illuminant: Illuminant) -> None:
    """Raise UsageError unless the illuminant is D65; linear sRGB colours are defined only under D65."""
    if not illuminant.is_d65:
        raise UsageError(
            f"illuminant {illuminant.name} needs a spectrum, and RGB materials have none; use the _spec file, or D65"
        )


def render_scene(mi: Any, scene: Any, settings: RenderSettings) -> Array:
    """Render the channels of a scene's film, float64, shape (size, size, channels).

    Long renders are split into passes of a few seconds; each has its own seed, derived from that of the settings.
    """
    most = max(1, _LANES // settings.size**2)
    n_passes = -(-settings.samples // most)
    seeds = np.random.SeedSequence(settings.seed).generate_state(n_passes)
    ends = np.arange(1, n_passes + 1) * settings.samples // n_passes
    total: Array | float = 0.0
    with backend.only_errors():
        for k, count in progress.each(enumerate(np.diff(ends, prepend=0))):
            picture = mi.render(scene, spp=int(count), seed=int(seeds[k]))
            total = total + int(count) * np.array(picture, dtype=np.float64)
    return np.asarray(total) / settings.samples


def rgb_film(size: int) -> dict[str, Any]:
    """Return Mitsuba's own film in linear sRGB, as a dictionary. In spectral variants its white is D65."""
    return {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "pixel_format": "rgb",
        "rfilter": {"type": "box"},
    }


def colorimetric_film(mi: Any, size: int, illuminant: Illuminant) -> dict[str, Any]:
    """Return a film with the channels X, Y, Z of the scene under an illuminant; a white diffuser has Y = 1.

    Environments of Mitsuba have the spectrum of D65 times a reflectance; the film compensates for it.
    """
    wavelengths_nm, responses = sensor_responses(illuminant)
    seen = (wavelengths_nm >= 360.0) & (wavelengths_nm <= 830.0)
    wavelengths_nm, responses = wavelengths_nm[seen], responses[seen]
    shining = _environment_spectrum(mi, wavelengths_nm)
    weights = responses / shining[:, None]
    channels = {
        name: {
            "type": "regular",
            "wavelength_min": float(wavelengths_nm[0]),
            "wavelength_max": float(wavelengths_nm[-1]),
            "values": ",".join(f"{v:.9g}" for v in column),
        }
        for name, column in zip("XYZ", weights.T, strict=True)
    }
    return {
        "type": "specfilm",
        "width": size,
        "height": size,
        "rfilter": {"type": "box"},
        **channels,
    }


def _environment_spectrum(mi: Any, wavelengths_nm: Array) -> Array:
    """Return the radiance of a white environment of Mitsuba at wavelengths (K,)."""
    light = mi.load_dict({"type": "d65"})
    if mi.variant().startswith("llvm"):  # all at once: a kernel is compiled for every wavelength otherwise
        many = backend.drjit().zeros(mi.SurfaceInteraction3f, len(wavelengths_nm))
        many.wavelengths = mi.Spectrum(mi.Float(wavelengths_nm.astype(np.float32)))
        return np.array(light.eval(many)[0], dtype=np.float64)
    interaction = mi.SurfaceInteraction3f()
    values = np.empty(len(wavelengths_nm))
    for k, wavelength in enumerate(wavelengths_nm):
        interaction.wavelengths = mi.Spectrum(float(wavelength))
        values[k] = np.ravel(light.eval(interaction))[0]
    return values
