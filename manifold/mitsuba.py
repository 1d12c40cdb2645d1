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
    """Return the dictionary with which `mi.load_dict` creates the BSDF of a prediction.

    The arguments are checked here, so that an error is one line, without Mitsuba's own text and traceback.

    Args:
        model: path of the model, or `built-in`.
        latent: coordinates, shape (Q,), or a text: coordinates such as "-0.3,1.2", or the name of a material of the
            model.
        library: path of the model's library, if the library was moved.
        tolerance: leave out materials whose weights change the mapped values by at most this share of their norm.
        colour: one of `like`, `reflectance` and `srgb`, as in `manifold predict`.

    Raises:
        MissingModelError, ModelError: there is no such model, or it is damaged.
        LatentError, UnknownNameError: the latent has the wrong number of coordinates, or names no material.
        UsageError: the text is a step between two materials (`FROM:TO:T`), which is not a latent.
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
