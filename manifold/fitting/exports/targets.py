"""The targets of exports: names, suffixes, parameters, shading models and writers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from manifold.errors import UsageError
from manifold.fitting.exports import (
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
from manifold.fitting.exports.document import Export
from manifold.fitting.exports.principled_values import Principled
from manifold.records import Array

Brdf = Callable[[Mapping[str, Any], Array, Array], Array]
Content = Callable[[Export, Principled], bytes]


@dataclass(frozen=True)
class Target:
    """A target of exports.

    Attributes:
        name: as users say it.
        suffix: of its files; several targets share `.json`.
        defaults: every parameter that exports may set.
        parameters: those of a material.
        brdf: the target's own shading model, f in 1/sr of parameters, view and light.
        content: the file of an export.
        title: in words.
        free: parameters that a direct fit changes.
        coat, sheen: those of the coat and of the sheen, the weight first; empty where there is none.
        film: those of the thin film, the thickness in nm and the index last; empty where there is none.
    """

    name: str
    suffix: str
    defaults: Mapping[str, Any]
    parameters: Callable[[Principled], dict[str, Any]]
    brdf: Brdf
    content: Content
    title: str
    free: tuple[str, ...]
    coat: tuple[str, ...]
    sheen: tuple[str, ...]
    film: tuple[str, ...]


def _json(conventions: Mapping[str, str]) -> Content:
    def content(export: Export, material: Principled) -> bytes:
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


def _target(name: str, suffix: str, model: ModuleType, content: Content, title: str) -> Target:
    """A target whose parameters and shading model are those of a module."""
    sheen, film = (getattr(model, name, ()) for name in ("SHEEN", "FILM"))
    return Target(
        name, suffix, model.DEFAULTS, model.parameters, model.brdf, content, title,
        model.FREE, model.COAT, sheen, film,
    )  # fmt: skip


_ALL = (
    _target("gltf", ".glb", gltf, lambda export, _: glb.glb(export), "glTF 2.0, metallic-roughness and extensions"),
    _target("openpbr", ".mtlx", openpbr, lambda export, _: materialx.mtlx(export), "MaterialX, open_pbr_surface"),
    _target(
        "standard-surface", ".mtlx", standard_surface, lambda export, _: materialx.mtlx(export),
        "MaterialX, standard_surface",
    ),
    _target(
        "usd", ".usda", preview_surface, lambda export, _: usd.usda(export).encode(), "USD, UsdPreviewSurface"
    ),
    _target(
        "usd-materialx", ".usda", preview_surface,
        lambda export, material: usd.usda(export, openpbr.parameters(material)).encode(),
        "USD, UsdPreviewSurface with OpenPBR beside it for MaterialX renderers",
    ),
    _target(
        "blender", ".py", blender, lambda export, _: blender.script(export).encode(),
        "Blender 4 and later, Principled BSDF, a script",
    ),
    _target("blender-json", ".json", blender, _json(_BLENDER), "Blender 4 and later, Principled BSDF, values"),
    _target("unreal", ".json", unreal, _json(unreal.CONVENTIONS), "Unreal Engine 5, Default Lit or Clear Coat"),
    _target("unity", ".json", unity, _json(unity.CONVENTIONS), "Unity, High Definition pipeline, Lit"),
)  # fmt: skip

TARGETS: Mapping[str, Target] = {target.name: target for target in _ALL}
"""The targets by name."""


def target_of(name: str | None, path: Path, fitted: str | None = None) -> Target:
    """The target of that name, or the one that a file's suffix tells.

    Args:
        name: of the target, if it was named.
        path: of the file.
        fitted: name of the target whose model a fit has: among those of the suffix, it or one of the same model.
    Raises:
        UsageError: there is none, or the suffix is another's.
    """
    if name is not None and name not in TARGETS:
        raise UsageError(f"no target is called {name!r}, expected one of {', '.join(TARGETS)}")
    if name is None:
        fitting = [target for target in _ALL if target.suffix == path.suffix.lower()]
        if not fitting:
            known = ", ".join(dict.fromkeys(target.suffix for target in _ALL))
            raise UsageError(f"{path}: suffix {path.suffix or 'missing'!r}, expected one of {known}")
        if (own := TARGETS.get(fitted or "")) is not None:
            alike = [target for target in fitting if target.brdf is own.brdf]
            fitting = [own] if own in alike else alike or fitting
        if path.suffix.lower() == ".json" and len(fitting) > 1:
            names = ", ".join(target.name for target in fitting)
            raise UsageError(f"{path}: several targets are JSON; say which with --target: {names}")
        return fitting[0]
    target = TARGETS[name]
    if path.suffix.lower() != target.suffix:
        raise UsageError(f"{path}: suffix {path.suffix or 'missing'!r}, expected {target.suffix} for {name}")
    return target
