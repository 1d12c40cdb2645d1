"""The BSDF plugin `manifold` for scenes of Mitsuba: importing this module registers it in every variant that is set.

import mitsuba as mi
import manifold.mitsuba

mi.set_variant("llvm_ad_spectral")
bsdf = mi.load_dict(manifold.mitsuba.bsdf("model.h5", [-0.3, 1.2]))
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import manifold.render.render  # noqa: F401  # registers the plugin
from manifold.core import shipped
from manifold.model.manifold import load_model
from manifold.render.plugin.bsdf import NAME, place_of


def bsdf(
    model: Path | str, latent: Sequence[float] | str, *, library: Path | str | None = None, tolerance: float = 0.0,
    **colour: str,
) -> dict[str, str | float]:  # fmt: skip
    """Return the dictionary of a prediction for `mi.load_dict`, checked here, where errors are one line.

    Errors of `mi.load_dict` repeat such a line after Mitsuba's own text and a traceback.

    Args:
        model: path of the model, or `built-in`.
        latent: coordinates, shape (Q,), or as text: "-0.3,1.2", or a material of the model.
        library: path of the library, if it was moved.
        tolerance: leave out materials that change mapped values by at most this share of their norm.
        colour: one of `like`, `reflectance` and `srgb`, as in `manifold predict`.

    Raises:
        MissingModelError, ModelError: there is no such model, or it is damaged.
        LatentError, UnknownNameError: the latent has the wrong number of coordinates, or names no material.
        UsageError: the latent is a step of a walk.
    """
    place = latent if isinstance(latent, str) else ",".join(repr(float(value)) for value in latent)
    place_of(load_model(Path(model), None if library is None else Path(library)), place)
    properties: dict[str, str | float] = {
        "type": NAME,
        "model": shipped.named(model),
        "latent": place,
        "tolerance": tolerance,
    }
    if library is not None:
        properties["library"] = shipped.named(library)
    return {**properties, **colour}
