"""Describes one exported material for one target."""

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
        default: the target's default value; a list of three for a colour.
        is_free: whether a direct fit changes the parameter.
        low, high: range of the parameter in direct fits.
        ridge: weight of the distance from the start in direct fits, so that undetermined parameters keep their start:
            the reduction of the relative residual that justifies a step through the whole range.
    """

    default: Any
    is_free: bool = False
    low: float = 0.0
    high: float = 1.0
    ridge: float = 1e-3

    @property
    def is_share(self) -> bool:
        """Return whether the parameter ranges from 0 to 1; a fitted value near an end is then set to that end."""
        return (self.low, self.high) == (0.0, 1.0)


_TINT_RIDGE = 0.01


def tint_parameter() -> Parameter:
    """Return the parameter of a specular colour, which a fit changes only if the samples support it.

    It affects little of the light in a fit, but all of a ball's rim in front of a bright background.
    """
    return Parameter([1.0, 1.0, 1.0], is_free=True, ridge=_TINT_RIDGE)


def defaults(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """Return the default of every parameter, which the target uses if a file does not set it."""
    return {name: parameter.default for name, parameter in parameters.items()}


CURVE_COSINES = (0.0, 0.35, 0.6, 0.8, 1.0)
"""Cosines between normal and view at which a view-dependent base colour is given; it is linear between them."""


@dataclass(frozen=True)
class TextureFiles:
    """Files of a material's textures, which tile without seams.

    Attributes:
        base_colour: PNG in sRGB that replaces the base colour.
        normal: PNG of normals in tangent space, y up, as in OpenGL and glTF.
        coat: PNG of linear values that replaces the coat's weight (red) and roughness (green); None for a uniform
            coat.
        coat_normal: PNG of the coat's normals, like `normal`; None if `coat` is None.
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
        name: name of the material.
        target: name of the target.
        parameters: all parameters of the target; colours are from 0 to 1.
        source: origin of the parameters, as plain values.
        errors: ball errors of the target's own shading model with respect to `against`.
        principled_errors: ball errors of Mitsuba's `principled`; None if `against` is that fit.
        against: `measured file`, `prediction` or `fit`.
        beside: parameters of `Target.beside`; None if the target has none.
        textures: textures that replace the base colour and the flat normal; None for a uniform material.
        implementations: errors by the name of each program that implements the model differently, of which `errors`
            holds the worst; empty if only one implementation is known.
        colour_space: colour space of all colours.
        caveat: text for users of the target; empty for most targets.
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
        """The name with unprintable characters replaced by question marks, because programs refuse them."""
        return "".join(c if c.isprintable() else "?" for c in self.name)

    def about(self) -> dict[str, Any]:
        """Return everything except the parameters, as plain values."""
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
        """Return one line of text about the material and its errors."""
        caveat = f"; {self.caveat}" if self.caveat else ""
        return (
            f"{self.label}: Exported by manifold {__version__} for {self.target}; colours are {self.colour_space}; "
            f"CIEDE2000 of the ball against the {self.against}: {self.errors_in_words()}{caveat}"
        )

    def errors_in_words(self) -> str:
        """Return a text with the errors, of each implementation if there are several."""
        each = [f"{errors} in {name}" for name, errors in self.implementations.items()]
        return ", ".join(each) or str(self.errors)

    def to_json(self) -> dict[str, Any]:
        """Return the entries of the command's JSON as plain values."""
        return self.about() | {"parameters": dict(self.parameters)}

    def json_file(self, conventions: Mapping[str, str], **more: Any) -> bytes:
        """Return the bytes of a JSON file with all values and the conventions of the parameters."""
        made = self.to_json() | {"about": self.sentence(), "conventions": dict(conventions)} | more
        return (json.dumps(made, indent=2, allow_nan=False) + "\n").encode()
