"""Describes the free parameters of a BSDF and their ranges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from manifold.core.errors import UsageError
from manifold.core.records import Array, plain

Transform = Literal["identity", "log", "square", "gloss"]
"""Name of the optimiser's coordinate of a parameter p.

`identity` is p, `log` is log p, `square` is the square root of the distance from the minimum, and `gloss` is minus
the logarithm of the distance from the maximum plus a hundredth of the range, for parameters that set the width of a
lobe."""

_LOG_FLOOR = 1e-6  # least value whose logarithm is taken
_GLOSS_FLOOR = 0.0101  # Mitsuba's clear coat: alpha 0.1 at gloss 0, 0.001 at gloss 1


@dataclass(frozen=True)
class FreeParameter:
    """A parameter of a Mitsuba BSDF that a fit may change, with its range.

    Attributes:
        name: name in Mitsuba's dictionaries.
        minimum, maximum: the range, ends included.
        default: start of the search, and value if none is given.
        transform: the transform into the coordinate of the optimiser.
        per_band: whether there is one value per band, as for a colour, or one for all bands.
        affine: whether the BSDF is an affine function of the parameter in each band; the global search then solves
            for it exactly.
        tolerance: the parameter counts as determined if twice its standard error is at most this.
        undetermined: the value that it keeps if the data do not determine it; None to keep the fitted value.
    """

    name: str
    minimum: float
    maximum: float
    default: float
    transform: Transform = "identity"
    per_band: bool = False
    affine: bool = False
    tolerance: float = 0.02
    undetermined: float | None = None

    def __post_init__(self) -> None:
        """Raise UsageError for a range without values, or without the default."""
        kept = self.default if self.undetermined is None else self.undetermined
        if not (
            self.minimum < self.maximum
            and self.minimum <= self.default <= self.maximum
            and self.minimum <= kept <= self.maximum
        ):
            raise UsageError(
                f"parameter {self.name}: range {self.minimum} to {self.maximum}, default {self.default}; "
                "expected minimum < maximum, with the default and `undetermined` between"
            )
        if self.transform == "log" and self.minimum < 0:
            raise UsageError(
                f"parameter {self.name}: log needs a minimum of at least 0, found {self.minimum}"
            )

    @property
    def range(self) -> float:
        """Width of the range, maximum minus minimum."""
        return self.maximum - self.minimum

    def inward(self, p: Array | float) -> Array:
        """Return values p in the coordinates of the optimiser."""
        p = np.asarray(p, float)
        if self.transform == "log":
            return np.log(np.maximum(p, _LOG_FLOOR))
        if self.transform == "square":
            return np.sqrt(np.maximum(p - self.minimum, 0.0))
        if self.transform == "gloss":
            return -np.log(self.maximum + _GLOSS_FLOOR * self.range - p)
        return p

    def outward(self, t: Array | float) -> Array:
        """Return the values of the optimiser's coordinates; the inverse of `inward`."""
        t = np.asarray(t, float)
        if self.transform == "log":
            return np.clip(np.exp(t), self.minimum, self.maximum)
        if self.transform == "square":
            return self.minimum + t * t
        if self.transform == "gloss":
            return np.clip(self.maximum + _GLOSS_FLOOR * self.range - np.exp(-t), self.minimum, self.maximum)
        return t

    def slope(self, t: Array | float) -> Array:
        """Return the derivative of `outward`."""
        t = np.asarray(t, float)
        if self.transform == "log":
            return np.exp(t)
        if self.transform == "square":
            return 2.0 * t
        if self.transform == "gloss":
            return np.exp(-t)
        return np.ones_like(t)


@dataclass(frozen=True)
class BsdfFamily:
    """A type of Mitsuba BSDF with its free and fixed parameters.

    Attributes:
        type: the plugin's name, built in or registered from Python.
        parameters: the free parameters.
        fixed: the fixed entries of the plugin's dictionary.
    """

    type: str
    parameters: tuple[FreeParameter, ...]
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        if not names or len(set(names)) != len(names) or set(names) & set(self.fixed):
            raise UsageError(
                f"BSDF {self.type}: free parameters {', '.join(names) or 'none'} and fixed "
                f"{', '.join(self.fixed) or 'none'}; expected at least one free, each named once"
            )

    def named(self, name: str) -> FreeParameter:
        """Return the free parameter with a name.

        Raises:
            UsageError: there is no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(parameter.name for parameter in self.parameters)
        raise UsageError(f"BSDF {self.type} has no free parameter {name!r}; found {known}")

    def to_json(self) -> dict[str, Any]:
        """Return plain values, which `from_json` reads."""
        return plain({"type": self.type, "parameters": self.parameters, "fixed": self.fixed})

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> BsdfFamily:
        """Restore the family from the content of `to_json`; files are validated by `fit_json.family_of`."""
        parameters = tuple(FreeParameter(**entry) for entry in content["parameters"])
        return cls(content["type"], parameters, dict(content.get("fixed", {})))


class ParameterLayout:
    """The layout of a family's parameters in one vector of K numbers, for B bands.

    Parameters have the order of the family; a parameter per band takes B places.

    Attributes:
        slices: slice of each parameter by name.
        owner: index of the parameter of each place.
        size: K.
        minimum, maximum, default, tolerance: these properties of the parameter at each place, shape (K,).
        is_per_band: whether the parameter of a place is per band, bool (K,).
        labels: name of each place, with the index of the band if the parameter is per band.
    """

    def __init__(self, family: BsdfFamily, n_bands: int) -> None:
        self.family, self.n_bands = family, n_bands
        self.slices: dict[str, slice] = {}
        owner: list[FreeParameter] = []
        labels: list[str] = []
        for o in family.parameters:
            size = n_bands if o.per_band else 1
            self.slices[o.name] = slice(len(owner), len(owner) + size)
            owner += [o] * size
            labels += [f"{o.name}[{k}]" for k in range(size)] if o.per_band else [o.name]
        self.owner, self.labels, self.size = tuple(owner), tuple(labels), len(owner)
        self.minimum, self.maximum, self.default, self.tolerance = np.array(
            [(o.minimum, o.maximum, o.default, o.tolerance) for o in owner], float
        ).T
        self.is_per_band = np.array([o.per_band for o in owner])

    def inward(self, p: Array) -> Array:
        """Return values (..., K) in the optimiser's coordinates."""
        return np.stack([o.inward(p[..., k]) for k, o in enumerate(self.owner)], axis=-1)

    def outward(self, t: Array) -> Array:
        """Return values (..., K) from the optimiser's coordinates; the inverse of `inward`."""
        return np.stack([o.outward(t[..., k]) for k, o in enumerate(self.owner)], axis=-1)

    def slope(self, t: Array) -> Array:
        """Return the derivative of `outward`, element by element, in the shape of t."""
        return np.stack([o.slope(t[..., k]) for k, o in enumerate(self.owner)], axis=-1)

    def join(self, values: Mapping[str, Any]) -> Array:
        """Return the vector (K,) of values by name, with defaults for missing names."""
        out: Array = self.default.copy()
        for name, value in values.items():
            out[self.slices[name]] = value
        return out

    def split(self, p: Array) -> dict[str, float | list[float]]:
        """Return the values by name, each a number or a list of B numbers."""
        return {
            name: [float(v) for v in p[place]] if self.family.named(name).per_band else float(p[place.start])
            for name, place in self.slices.items()
        }


_COLOUR = FreeParameter("base_color", 0.0, 1.0, 0.5, per_band=True, affine=True, tolerance=0.01)
_WIDE = replace(_COLOUR, minimum=-0.25, maximum=1.25)  # colours outside Rec. 709 are found, and reported

# Undetermined ones keep Mitsuba's defaults.
_PRINCIPLED = (
    _COLOUR,
    FreeParameter("metallic", 0.0, 1.0, 0.2, undetermined=0.0),
    FreeParameter("roughness", 0.02, 1.0, 0.5, transform="log", undetermined=0.5),
    # The index is a smooth function of the square root. At 0, Mitsuba leaves out the metal's highlight as well.
    FreeParameter("specular", 1e-9, 1.0, 0.5, transform="square", undetermined=0.5),
    FreeParameter("clearcoat", 0.0, 1.0, 0.2, undetermined=0.0),
    FreeParameter("clearcoat_gloss", 0.0, 1.0, 0.8, transform="gloss", undetermined=0.0),
    FreeParameter("sheen", 0.0, 1.0, 0.1, undetermined=0.0),
    FreeParameter("spec_tint", 0.0, 1.0, 0.1, undetermined=0.0),
    FreeParameter("sheen_tint", 0.0, 1.0, 0.1, undetermined=0.0),
    FreeParameter("flatness", 0.0, 1.0, 0.1, undetermined=0.0),
    FreeParameter("anisotropic", 0.0, 1.0, 0.1, undetermined=0.0),
)

PRINCIPLED_DEFAULT = (
    "base_color", "metallic", "roughness", "specular", "clearcoat", "clearcoat_gloss", "sheen",
)  # fmt: skip
"""Parameters that are free by default; see docs/explanation/fits.md."""


def principled(names: Iterable[str] = PRINCIPLED_DEFAULT, *, wide_colours: bool = False) -> BsdfFamily:
    """Return Mitsuba's `principled` with the named parameters free and the others at Mitsuba's defaults.

    With `wide_colours`, base colours range from -0.25 to 1.25 instead of 0 to 1.

    `roughness` is the artist's parameter: Mitsuba squares it to get the GGX alpha.
    """
    colour = _WIDE if wide_colours else _COLOUR
    family = BsdfFamily("principled", (colour, *_PRINCIPLED[1:]))
    return BsdfFamily("principled", tuple(family.named(name) for name in names))


def default_principled(is_isotropic: bool, *, wide_colours: bool) -> BsdfFamily:
    """Return `principled` with its default free parameters, which include `anisotropic` for anisotropic materials."""
    names = PRINCIPLED_DEFAULT if is_isotropic else (*PRINCIPLED_DEFAULT, "anisotropic")
    return principled(names, wide_colours=wide_colours)


def diffuse(*, wide_colours: bool = False) -> BsdfFamily:
    """Return Mitsuba's `diffuse` with a free reflectance; `wide_colours` widens its range as for `principled`."""
    return BsdfFamily("diffuse", (replace(_WIDE if wide_colours else _COLOUR, name="reflectance"),))
