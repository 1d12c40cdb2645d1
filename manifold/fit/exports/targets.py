"""A target of exports: its names, suffix, parameters, shading model and writer, made by the module of its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core.errors import UsageError
from manifold.core.records import Array, Bands
from manifold.fit.exports.document import Export, Parameter, defaults
from manifold.fit.exports.lobes import ShadingPairs
from manifold.fit.exports.principled_values import PrincipledValues
from manifold.registries import EXPORTS_IN_WORDS
from manifold.registries import TARGETS as TARGETS

Brdf = Callable[[Mapping[str, Any], ShadingPairs], Array]
Content = Callable[[Export], bytes]


RELIEF = ("base_colour", "normal")
"""The textures of targets whose coats take none."""

FLAKES = (*RELIEF, "coat", "coat_normal")
"""The textures of targets whose coats take them, for flakes."""


def uncompared(engine: str) -> str:
    """Return the caveat of a target whose shading model is known by its published formulas only."""
    return (
        f"never compared with a render of {engine}: the model is that of its published formulas; "
        "--target shader writes the BRDF itself"
    )


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
        implementations: BRDFs by the names of programs that evaluate the parameters differently, `brdf` the first of
            them: fits suit all. Empty if one is known.
        colour_space: of all its colours.
        caveat: what its files say to their users; empty for most targets.
    """

    name: str
    suffix: str
    title: str
    entries: Mapping[str, Parameter]
    parameters: Callable[[PrincipledValues], dict[str, Any]]
    brdf: Brdf
    content: Content
    base_colour: str
    coat: tuple[str, ...] = ()
    sheen: tuple[str, ...] = ()
    film: tuple[str, ...] = ()
    curve: tuple[str, ...] = ()
    hued: tuple[str, ...] = ()
    textures: tuple[str, ...] = ()
    beside: str | None = None
    implementations: Mapping[str, Brdf] = field(default_factory=dict)
    colour_space: str = "linear Rec. 709"
    caveat: str = ""

    @property
    def brdfs(self) -> tuple[Brdf, ...]:
        """Return the BRDFs of all implementations."""
        return tuple(self.implementations.values()) or (self.brdf,)

    @property
    def defaults(self) -> dict[str, Any]:
        """The target's value of every parameter that is not set."""
        return defaults(self.entries)


@dataclass(frozen=True)
class TargetBRDF:
    """A target's own model with values of its parameters, as a BRDF in linear sRGB; by one of its implementations."""

    target: Target
    values: Mapping[str, Any]
    implementation: str | None = None
    bands: Bands = Bands(None)  # noqa: RUF009
    is_isotropic: bool = True

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., 3), for unit vectors that broadcast, wi to the viewer; 0 below the horizon."""
        wi, wo = np.broadcast_arrays(wi, wo)
        above = (wi[..., 2] > 0.0) & (wo[..., 2] > 0.0)
        f = np.zeros(wi.shape)
        brdf = self.target.brdf
        if self.implementation is not None:
            brdf = self.target.implementations[self.implementation]
        f[above] = brdf(self.values, ShadingPairs.of(wi[above], wo[above]))
        return f


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
        hint = "; a .glb file is a whole glTF file" if path.suffix.lower() == ".gltf" else ""
        raise UsageError(f"{path}: {suffix}, expected one of {EXPORTS_IN_WORDS}{hint}")
    if path.suffix.lower() == ".json":
        names = ", ".join(target.name for target in fitting)
        raise UsageError(f"{path}: several targets are JSON; name one of {names}")
    return fitting[0]
