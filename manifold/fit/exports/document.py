"""The description of one exported material for one target."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from manifold import __version__
from manifold.core.metrics import Errors


@dataclass(frozen=True)
class Parameter:
    """A parameter of a target's model.

    Attributes:
        default: of the target; a list of three for a colour.
        is_free: whether a direct fit changes it.
        low, high: the range of direct fits.
        ridge: weight in direct fits of the distance from the start, which undetermined parameters keep: the relative
            residual that a step through the whole range must save.
    """

    default: Any
    is_free: bool = False
    low: float = 0.0
    high: float = 1.0
    ridge: float = 1e-3

    @property
    def is_share(self) -> bool:
        """Return whether it ranges from 0 to 1; then a fit that comes near an end means that end."""
        return (self.low, self.high) == (0.0, 1.0)


_TINT_RIDGE = 0.01


def tint_parameter() -> Parameter:
    """Return the parameter of a specular colour, which a fit moves if the samples support it.

    Little of the light that a fit sees depends on it, but all of the rim in front of a bright background.
    """
    return Parameter([1.0, 1.0, 1.0], is_free=True, ridge=_TINT_RIDGE)


def defaults(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return the default of every parameter, which the target uses if a file does not set it."""
    return {name: parameter.default for name, parameter in parameters.items()}


CURVE_COSINES = (0.0, 0.35, 0.6, 0.8, 1.0)
"""Between normal and view, of the colours of a base that changes with the angle; linear between."""


@dataclass(frozen=True)
class TextureFiles:
    """Pictures beside a material's document, which continue across their edges.

    Attributes:
        base_colour: PNG in sRGB; stands in place of the base colour.
        normal: PNG of normals in tangent space, y up, as OpenGL and glTF have them.
        coat: PNG of linear values, the weight of the coat in red and its roughness in green; stands in place of both.
            None for the same coat everywhere.
        coat_normal: normals of the coat, as `normal`; None with `coat`.
    """

    base_colour: Path
    normal: Path
    coat: Path | None = None
    coat_normal: Path | None = None

    @property
    def named(self) -> dict[str, Path]:
        """Return the existing files by their attributes."""
        return {name: path for name, path in vars(self).items() if path is not None}


@dataclass(frozen=True)
class Export:
    """A material as parameters of a target.

    Attributes:
        name: of the material.
        target: name of the target.
        parameters: of the target, all that it knows; colours are from 0 to 1.
        source: where the parameters come from, plain values.
        errors: of the ball of the target's own model, from what `against` names.
        principled_errors: those of Mitsuba's `principled`; None where that is what `against` names.
        against: `measured file`, `prediction` or `fit`.
        beside: parameters of `Target.beside`; None if the target has none.
        textures: in place of the base colour and the flat normal; None for one material everywhere.
        implementations: errors by the names of programs that evaluate the parameters differently, `errors` the worst of
            them; empty if one is known.
        colour_space: of all colours.
        caveat: what users of the target should know; empty for most targets.
    """

    name: str
    target: str
    parameters: Mapping[str, Any]
    source: Mapping[str, Any]
    errors: Errors[float]
    principled_errors: Errors[float] | None
    against: str
    beside: Mapping[str, Any] | None = None
    textures: TextureFiles | None = None
    implementations: Mapping[str, Errors[float]] = field(default_factory=dict)
    colour_space: str = "linear Rec. 709"
    caveat: str = ""

    @property
    def label(self) -> str:
        """The name with question marks for unprintable characters, which programs refuse in names."""
        return "".join(c if c.isprintable() else "?" for c in self.name)

    def about(self) -> dict[str, Any]:
        """Return everything but the parameters, as plain values."""
        made: dict[str, Any] = {
            "program": f"manifold {__version__}",
            "material": self.name,
            "target": self.target,
            "source": dict(self.source),
            "errors": self.errors.to_json(),
            "principled_errors": self.principled_errors and self.principled_errors.to_json(),
            "against": self.against,
            "colour_space": self.colour_space,
        }
        if self.implementations:
            made["implementations"] = {name: each.to_json() for name, each in self.implementations.items()}
        if self.caveat:
            made["caveat"] = self.caveat
        if self.textures is not None:
            made["textures"] = {k: path.name for k, path in self.textures.named.items()}
        return made

    def sentence(self) -> str:
        """Return one line for people."""
        caveat = f"; {self.caveat}" if self.caveat else ""
        return (
            f"{self.label}: Exported by manifold {__version__} for {self.target}; colours are {self.colour_space}; "
            f"CIEDE2000 of the ball against the {self.against}: {self.errors_in_words()}{caveat}"
        )

    def errors_in_words(self) -> str:
        """Return the errors, of each implementation if there are several."""
        each = [f"{errors} in {name}" for name, errors in self.implementations.items()]
        return ", ".join(each) or str(self.errors)

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return self.about() | {"parameters": dict(self.parameters)}

    def json_file(self, conventions: Mapping[str, str], **more: Any) -> bytes:
        """Return a file of plain values, with the conventions of the parameters."""
        made = self.to_json() | {"about": self.sentence(), "conventions": dict(conventions)} | more
        return (json.dumps(made, indent=2, allow_nan=False) + "\n").encode()
