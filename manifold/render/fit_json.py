"""Reads and writes fits as JSON, with their inputs and settings. The schema is `fit.schema.json`."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from manifold import __version__
from manifold.core import disk
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.extras import require
from manifold.render.bsdf_evaluation import bsdf_dict, is_analytic, load_bsdf
from manifold.render.bsdf_parameters import BsdfFamily, FreeParameter
from manifold.render.plugin_names import holds_none, require_plugins, types_of

_SLACK = 1e-6  # share of a range: single precision of a value at its end


@lru_cache(maxsize=1)
def schema() -> dict[str, Any]:
    """Return the JSON schema of a fit."""
    text = files("manifold.render").joinpath("fit.schema.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


@lru_cache(maxsize=2)
def _validator(part: str | None) -> Any:
    """Return a validator of the schema, or of one entry.

    Numbers are finite and fit a float, and 1.0 is no integer.
    """
    jsonschema = require("jsonschema")
    Draft = jsonschema.Draft202012Validator
    checker = Draft.TYPE_CHECKER.redefine_many(
        {
            "number": lambda _, value: is_number(value),
            "integer": lambda _, value: is_number(value) and isinstance(value, int),
        }
    )
    wanted = schema() if part is None else schema()["properties"][part]
    return jsonschema.validators.extend(Draft, type_checker=checker)(wanted)


def is_number(value: Any) -> bool:
    """Return whether a value of a JSON document is a finite number that a float can hold."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def family_of(content: Any, file: str) -> BsdfFamily:
    """Return the family of a JSON description of a BSDF, see `BsdfFamily.to_json`; errors name the file."""
    _require_schema(content, file, "bsdf")
    if holds_none(content.get("fixed", {})):  # null ends Mitsuba's process
        raise FileFormatError(f"{file}: fixed contains null, expected a value; remove that entry")
    try:
        family = BsdfFamily.from_json(content)
    except UsageError as error:
        raise FileFormatError(f"{file}: {error}") from error
    if not is_analytic(family):
        require_plugins(types_of(content), file)
    return family


def require_fit(content: Any, file: str) -> None:
    """Raise FileFormatError unless the content of a file is a valid fit.

    The message names the file and the first invalid entry.

    Values must lie in the ranges of their parameters, and the entries that Mitsuba loads must agree with them.
    """
    _require_schema(content, file)
    family = family_of(content["bsdf"], file)
    values, spectra = content["values"], content["spectra"]
    _require_values(values, family.parameters, 3, f"{file}: values")
    _require_same(content["mitsuba"], bsdf_dict(family, values), f"{file}: mitsuba")
    spectral = None
    if spectra is not None:
        nm = spectra["wavelengths_nm"]
        if any(after <= before for before, after in zip([0.0, *nm], nm, strict=False)):
            raise FileFormatError(f"{file}: spectra.wavelengths_nm do not increase from above 0; fit again")
        own = [parameter for parameter in family.parameters if parameter.per_band]
        _require_values(spectra["values"], own, len(nm), f"{file}: spectra.values", least=0.0)
        spectral = bsdf_dict(family, values | spectra["values"], nm)
    _require_same(content["mitsuba_spectral"], spectral, f"{file}: mitsuba_spectral")


def _require_schema(content: Any, file: str, part: str | None = None) -> None:
    """Raise FileFormatError, naming the first entry in the schema's order that does not follow it."""
    for error in _validator(part).iter_errors(content):
        where = "the document" if error.json_path == "$" else error.json_path.removeprefix("$.")
        rule = error.validator_value
        if error.validator == "required":
            missing = next(name for name in rule if name not in error.instance)
            raise FileFormatError(f"{file}: {where} has no {missing!r}, expected one")
        if error.validator in ("type", "enum"):
            expected = rule if isinstance(rule, str) else " or ".join(map(str, rule))
            raise FileFormatError(f"{file}: {where} is {_short(error.instance)}, expected {expected}")
        raise FileFormatError(f"{file}: {where}: {error.message[:200]}")


def _require_values(
    values: Mapping[str, Any],
    parameters: Sequence[FreeParameter],
    count: int,
    where: str,
    least: float = -math.inf,
) -> None:
    """Raise FileFormatError unless there is a number in its range for each parameter, `count` for one per band."""
    names = [parameter.name for parameter in parameters]
    if set(values) != set(names):
        found = ", ".join(sorted(values)) or "nothing"
        raise FileFormatError(f"{where} has {found}, expected {', '.join(names)}; fit again")
    for parameter in parameters:
        value = values[parameter.name]
        low, high, slack = max(parameter.minimum, least), parameter.maximum, _SLACK * parameter.range
        is_right = isinstance(value, list) == parameter.per_band
        numbers = value if isinstance(value, list) else [value]
        if (
            not is_right
            or len(numbers) != (count if parameter.per_band else 1)
            or not all(is_number(number) and low - slack <= number <= high + slack for number in numbers)
        ):
            wanted = f"{count} numbers" if parameter.per_band else "a number"
            raise FileFormatError(
                f"{where}.{parameter.name} is {_short(value)}, expected {wanted} from {low:g} to {high:g}; correct "
                "it, or fit again"
            )


def _require_same(found: Any, expected: dict[str, Any] | None, where: str) -> None:
    """Raise FileFormatError unless the BSDF to be rendered has the fitted values."""
    if found != expected:
        both = found or {}, expected or {}
        differing = sorted(key for key in {*both[0], *both[1]} if both[0].get(key) != both[1].get(key))
        raise FileFormatError(
            f"{where} and the values differ in {', '.join(differing)}; make them equal, or fit again"
        )


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


FORMAT_VERSION = 1
PROGRAM = f"manifold {__version__}"


@dataclass(frozen=True)
class FitSource:
    """Where the fitted values come from: a measured file, or a prediction.

    Attributes:
        file, sha256: name and hash of the measured file; None for a prediction.
        latent, model, model_sha256: latent, model file and its hash for a prediction; None for a file.
        walk: text that names a step of a walk, which has no latent; otherwise None.
        colour: text that names the colour of a prediction; None for a file, and if latents determine the colours.
    """

    name: str
    file: str | None = None
    sha256: str | None = None
    latent: tuple[float, ...] | None = None
    model: str | None = None
    model_sha256: str | None = None
    colour: str | None = None
    walk: str | None = None


def signed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a fit with a hash added, which reveals later changes."""
    return content | {"sha256": _digest(content)}


def is_untouched(content: dict[str, Any]) -> bool:
    """Return whether the content of a fit is unchanged since it was written, according to its hash."""
    return content.get("sha256") == _digest(content)


def _digest(content: dict[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def write_document(path: Path, content: dict[str, Any]) -> None:
    """Write the content of a fit to a JSON file."""
    disk.write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read(path: Path) -> dict[str, Any]:
    """Read and validate the content of a written fit."""
    content: dict[str, Any] = disk.read_json(path, "a .bsdf file or the JSON of a fit")
    require_fit(content, path.name)
    return content


def read_bsdf(path: Path) -> Any:
    """Read Mitsuba's BSDF of a written fit, in the RGB variant of the backend."""
    content = read(path)
    return load_bsdf(BsdfFamily.from_json(content["bsdf"]), content["values"])
