"""The targets of exports: names, suffixes, parameters, shading models and writers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands
from manifold.fit.exports import (
    blender,
    glb,
    gltf,
    materialx,
    openpbr,
    preview_surface,
    standard_surface,
    unity,
    unreal,
    usd,
)
from manifold.fit.exports.document import Export, Parameter, defaults
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.principled_values import Principled
from manifold.registries import EXPORT_SUFFIXES, EXPORTS_IN_WORDS
from manifold.registries import TARGETS as TARGETS

Brdf = Callable[[Mapping[str, Any], ShadingPairs], Array]
Content = Callable[[Export], bytes]


@dataclass(frozen=True)
class Target:
    """A target of exports.

    Attributes:
        name: as users say it.
        suffix: of its files; several targets share `.json`.
        title: in words.
        entries: every parameter that exports may set, by name.
        parameters: values of all of them for a material.
        brdf: the target's own shading model, f in 1/sr of parameters and pairs.
        content: the file of an export.
        base_colour: the parameter that a texture replaces.
        coat, sheen: parameters of the coat and of the sheen, the weight first; empty where there is none.
        film: those of the thin film, the thickness and the index last; empty where there is none.
        curve: the base colour by the angle of view, and the one that it replaces; empty where there is none.
        hued: colours whose hue no fit changes, since renderers disagree on what another one does.
        textures: what its documents take of `TextureFiles`; empty where they take none.
        beside: another target whose parameters its files also hold; None for most targets.
    """

    name: str
    suffix: str
    title: str
    entries: Mapping[str, Parameter]
    parameters: Callable[[Principled], dict[str, Any]]
    brdf: Brdf
    content: Content
    base_colour: str
    coat: tuple[str, ...]
    sheen: tuple[str, ...]
    film: tuple[str, ...]
    curve: tuple[str, ...] = ()
    hued: tuple[str, ...] = ()
    textures: tuple[str, ...] = ()
    beside: str | None = None

    @property
    def defaults(self) -> dict[str, Any]:
        """The target's value of every parameter that is not set."""
        return defaults(self.entries)


@dataclass(frozen=True)
class TargetBRDF:
    """A target's own model with values of its parameters, as a BRDF in linear sRGB."""

    target: Target
    values: Mapping[str, Any]
    bands: Bands = Bands(None)  # noqa: RUF009
    is_isotropic: bool = True

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., 3), for unit vectors that broadcast, wi to the viewer; 0 below the horizon."""
        wi, wo = np.broadcast_arrays(wi, wo)
        above = (wi[..., 2] > 0.0) & (wo[..., 2] > 0.0)
        f = np.zeros(wi.shape)
        f[above] = self.target.brdf(self.values, ShadingPairs.of(wi[above], wo[above]))
        return f


def _json(conventions: Mapping[str, str]) -> Content:
    def content(export: Export) -> bytes:
        made = export.to_json() | {"about": export.sentence(), "conventions": dict(conventions)}
        if export.target == "unreal":
            made["shading_model"] = unreal.shading_model(export.parameters)
        return (json.dumps(made, indent=2, allow_nan=False) + "\n").encode()

    return content


_BLENDER = {
    "Base Color": "scene-linear Rec. 709 (sRGB primaries), 0 to 1",
    "Roughness": "0 to 1; GGX alpha is its square; Coat Roughness alike",
    "IOR": "of the surface; Specular IOR Level 0.5 leaves its reflectance as it is",
}


_RELIEF = ("base_colour", "normal")
_FLAKES = (*_RELIEF, "coat", "coat_normal")


def _target(
    name: str, title: str, model: ModuleType, content: Content, textures: tuple[str, ...] = (),
    beside: str | None = None,
) -> Target:  # fmt: skip
    """Make a target from the parameters and shading model of a module."""
    sheen, film, curve, hued = (getattr(model, names, ()) for names in ("SHEEN", "FILM", "CURVE", "HUED"))
    return Target(
        name,
        EXPORT_SUFFIXES[name],
        title,
        model.PARAMETERS,
        model.parameters,
        model.brdf,
        content,
        model.BASE_COLOUR,
        model.COAT,
        sheen,
        film,
        curve,
        hued,
        textures,
        beside,
    )


GLTF = _target("gltf", "glTF 2.0, metallic-roughness and extensions", gltf, glb.glb, _FLAKES)
OPENPBR = _target("openpbr", "MaterialX, open_pbr_surface", openpbr, materialx.mtlx, _FLAKES)
STANDARD_SURFACE = _target(
    "standard-surface",
    "MaterialX, standard_surface",
    standard_surface,
    materialx.mtlx,
    _FLAKES,
)
USD = _target("usd", "USD, UsdPreviewSurface", preview_surface, lambda e: usd.usda(e).encode(), _RELIEF)
USD_MATERIALX = _target(
    "usd-materialx", "USD, UsdPreviewSurface with OpenPBR beside it for MaterialX renderers", preview_surface,
    lambda e: usd.usda(e).encode(), beside="openpbr",
)  # fmt: skip
BLENDER = _target(
    "blender", "Blender 4 and later, Principled BSDF, a script", blender, lambda e: blender.script(e).encode(),
    _FLAKES,
)  # fmt: skip
BLENDER_JSON = _target(
    "blender-json", "Blender 4 and later, Principled BSDF, values", blender, _json(_BLENDER)
)
UNREAL = _target("unreal", "Unreal Engine 5, Default Lit or Clear Coat", unreal, _json(unreal.CONVENTIONS))
UNITY = _target("unity", "Unity, High Definition pipeline, Lit", unity, _json(unity.CONVENTIONS))


def target_of(name: str | None, path: Path) -> Target:
    """Return the target of that name, or the one of a file's suffix.

    Raises:
        UsageError: there is none, or the suffix is another's.
    """
    suffix = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
    if name is not None:
        target = TARGETS[name]
        if path.suffix.lower() != target.suffix:
            raise UsageError(f"{path}: {suffix}, expected {target.suffix} for {name}")
        return target
    fitting = [target for target in TARGETS.values() if target.suffix == path.suffix.lower()]
    if not fitting:
        raise UsageError(f"{path}: {suffix}, expected one of {EXPORTS_IN_WORDS}")
    if path.suffix.lower() == ".json":
        names = ", ".join(target.name for target in fitting)
        raise UsageError(f"{path}: several targets are JSON; name one of {names}")
    return fitting[0]
