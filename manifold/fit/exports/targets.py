"""Describes export targets: name, suffix, parameters, shading model and writer of each."""

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
"""Textures of targets whose coats cannot have textures."""

FLAKES = (*RELIEF, "coat", "coat_normal")
"""Textures of targets whose coats can have textures, which show flakes."""


def uncompared(engine: str) -> str:
    """Return the caveat of a target whose shading model was not compared with the engine itself."""
    return (
        f"never compared with a render of {engine}: the model is that of its published formulas; "
        "--target shader writes the BRDF itself"
    )


@dataclass(frozen=True)
class Target:
    """A target of exports.

    Attributes:
        name: name of the target for users.
        suffix: suffix of its files; several targets share `.json`.
        title: full name of the target.
        entries: every parameter that exports may set, by name.
        parameters: function that returns the parameters for a material, from which a fit starts.
        brdf: the target's own shading model, a function of parameters and pairs that returns f in 1/sr.
        content: function that returns the file of an export.
        base_colour: name of the parameter that a texture replaces.
        coat, sheen: names of the parameters of coat and sheen, the weight first; empty if there are none.
        film: names of the parameters of the thin film, thickness and index last; empty if there are none.
        curve: names of the view-dependent base colour, and of the base colour that it replaces; empty if there is
            none.
        hued: names of colours whose hue no fit changes, because renderers treat them differently.
        textures: fields of `TextureFiles` that its documents use; empty if they use none.
        beside: another target whose parameters its files also hold; None for most targets.
        implementations: BRDFs by the names of programs that implement the model differently, first `brdf`; a fit must
            suit all. Empty if only one implementation is known.
        colour_space: colour space of all its colours.
        caveat: text that its files contain for users; empty for most targets.
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
    def file_suffix(self) -> str:
        """The end of its files' names: the suffix, after the target's name unless the suffix alone selects it."""
        sharing = [target.name for target in TARGETS.values() if target.suffix == self.suffix]
        is_selected = self.suffix != ".json" and sharing[:1] in ([], [self.name])
        return self.suffix if is_selected else f"_{self.name}{self.suffix}"

    @property
    def brdfs(self) -> tuple[Brdf, ...]:
        """Return the BRDFs of all implementations."""
        return tuple(self.implementations.values()) or (self.brdf,)

    @property
    def defaults(self) -> dict[str, Any]:
        """The target's default value of every parameter."""
        return defaults(self.entries)


@dataclass(frozen=True)
class TargetBRDF:
    """A target's own shading model with given parameters, as a BRDF in linear sRGB."""

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
    """Return the target with a name or, if the name is None, the target with the file's suffix.

    Raises:
        UsageError: there is no such target, or the suffix belongs to another target.
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
