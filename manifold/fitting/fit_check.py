"""Validation of the JSON of a fit: schema, and consistency of its entries."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

from manifold.errors import FileFormatError, UsageError
from manifold.fitting.bsdf_evaluation import bsdf_dict
from manifold.fitting.bsdf_parameters import BsdfFamily, FreeParameter, is_number

_SLACK = 1e-6  # of a range: single precision of a value at its end


@lru_cache(maxsize=1)
def schema() -> dict[str, Any]:
    """The JSON schema of a fit."""
    return json.loads(files("manifold.fitting").joinpath("fit.schema.json").read_text(encoding="utf-8"))


@lru_cache(maxsize=1)
def _validator() -> Any:
    """Of the schema; numbers are finite and fit a float, and 1.0 is no integer."""
    from jsonschema import Draft202012Validator as Draft
    from jsonschema.validators import extend

    checker = Draft.TYPE_CHECKER.redefine_many(
        {
            "number": lambda _, value: is_number(value),
            "integer": lambda _, value: is_number(value) and isinstance(value, int),
        }
    )
    return extend(Draft, type_checker=checker)(schema())


def require_fit(content: Any, file: str) -> None:
    """Raise FileFormatError unless plain values are a fit that can be used, naming the first entry that is not so.

    Values must lie in the ranges of their parameters, and the entries that Mitsuba loads must say the same as they.

    Args:
        content: of the JSON.
        file: its name, for the error.
    """
    _require_schema(content, file)
    try:
        family = BsdfFamily.from_json(content["bsdf"])
    except UsageError as error:
        raise FileFormatError(f"{file}: {error}; fit again") from error
    for metric in {content["metric"], *content["residuals"]}:
        if not is_number(content["residuals"].get(metric)):
            found = _short(content["residuals"].get(metric))
            raise FileFormatError(f"{file}: residuals.{metric} is {found}, expected a number; fit again")
    _require_names(content["values"], family.parameters, file, "values")
    for parameter in family.parameters:
        _require_values(content["values"][parameter.name], parameter, 3, parameter.minimum, file, "values")
    _require_same(content["mitsuba"], bsdf_dict(family, content["values"]), file, "mitsuba")
    expected = None if content["spectra"] is None else _spectral(content, family, file)
    _require_same(content["mitsuba_spectral"], expected, file, "mitsuba_spectral")


def _require_schema(content: Any, file: str) -> None:
    """Raise FileFormatError, naming the first entry in the schema's order that does not follow it."""
    for error in _validator().iter_errors(content):
        where = "the document" if error.json_path == "$" else error.json_path.removeprefix("$.")
        rule = error.validator_value
        if error.validator == "required":
            missing = next(name for name in rule if name not in error.instance)
            raise FileFormatError(f"{file}: {where} has no {missing!r}, expected one; fit again")
        expected = rule if isinstance(rule, str) else " or ".join(map(str, rule))
        raise FileFormatError(f"{file}: {where} is {_short(error.instance)}, expected {expected}; fit again")


def _spectral(content: dict[str, Any], family: BsdfFamily, file: str) -> dict[str, Any]:
    """The BSDF as Mitsuba's spectral variants load it."""
    wavelengths, values = content["spectra"]["wavelengths_nm"], content["spectra"]["values"]
    rising = all(before < after for before, after in zip([0.0, *wavelengths], wavelengths, strict=False))
    if not wavelengths or not rising:
        raise FileFormatError(f"{file}: spectra.wavelengths_nm do not increase from above 0; fit again")
    own = [parameter for parameter in family.parameters if parameter.per_band]
    _require_names(values, own, file, "spectra.values")
    for parameter in own:
        low = max(parameter.minimum, 0.0)  # Mitsuba takes no negative spectra
        _require_values(values[parameter.name], parameter, len(wavelengths), low, file, "spectra.values")
    return bsdf_dict(family, content["values"] | values, wavelengths)


def _require_names(
    values: Mapping[str, Any], parameters: Sequence[FreeParameter], file: str, where: str
) -> None:
    names = [parameter.name for parameter in parameters]
    if set(values) != set(names):
        raise FileFormatError(
            f"{file}: {where} has {', '.join(sorted(values)) or 'nothing'}, expected {', '.join(names)}; fit again"
        )


def _require_values(
    value: Any, parameter: FreeParameter, count: int, low: float, file: str, where: str
) -> None:
    slack = _SLACK * parameter.range
    many = parameter.per_band
    numbers = value if many and isinstance(value, list) else [value]
    is_right = isinstance(value, list) == many and len(numbers) == (count if many else 1)
    if not is_right or not all(
        is_number(number) and low - slack <= number <= parameter.maximum + slack for number in numbers
    ):
        wanted = f"{count} numbers" if many else "a number"
        raise FileFormatError(
            f"{file}: {where}.{parameter.name} is {_short(value)}, expected {wanted} from {low:g} to "
            f"{parameter.maximum:g}; correct it, or fit again"
        )


def _require_same(
    found: dict[str, Any] | None, expected: dict[str, Any] | None, file: str, where: str
) -> None:
    """Raise FileFormatError unless the BSDF to be rendered has the fitted values."""
    if found == expected:
        return
    if found is None or expected is None:
        other = "null" if expected is None else "an object"
        raise FileFormatError(f"{file}: {where} is {_short(found)}, expected {other}; fit again")
    differing = [key for key in sorted({*found, *expected}) if found.get(key) != expected.get(key)]
    raise FileFormatError(
        f"{file}: {where} and the values differ in {', '.join(differing)}; change both alike, or fit again"
    )


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return "an object"
    text = json.dumps(value) if not isinstance(value, list) or all(map(is_number, value)) else "an array"
    return text if len(text) <= 40 else text[:37] + "..."
