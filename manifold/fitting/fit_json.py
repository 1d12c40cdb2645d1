"""Fits as JSON: written with everything that made them, read back as BSDFs. Schema: `data/fit.schema.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from manifold import __version__, atomic
from manifold.errors import FileFormatError, UsageError
from manifold.fitting.bsdf_evaluation import bsdf_dict, load_bsdf
from manifold.fitting.bsdf_parameters import BsdfFamily
from manifold.principled import FitResult

FORMAT_VERSION = 1
PROGRAM = f"manifold {__version__}"

_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "number": (int, float), "integer": (int,),
    "boolean": (bool,), "null": (type(None),),
}  # fmt: skip


@dataclass(frozen=True)
class Source:
    """What was fitted.

    Attributes:
        name: of the material.
        file, sha256: name and hash of the measured file; None for a prediction.
        latent, model, model_sha256: where a prediction comes from, the model's file and its hash; None for a file.
        colour: of a prediction, in words; None for a file, and where latents carry their colours.
    """

    name: str
    file: str | None = None
    sha256: str | None = None
    latent: tuple[float, ...] | None = None
    model: str | None = None
    model_sha256: str | None = None
    colour: str | None = None


def document(result: FitResult, source: Source) -> dict[str, Any]:
    """A fit as plain values, as the schema describes them."""
    wavelengths = result.bands.wavelengths_nm
    spectral = dict(result.values) | result.spectra
    return {
        "format": "manifold fit",
        "format_version": FORMAT_VERSION,
        "program": PROGRAM,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": asdict(source) | {"latent": None if source.latent is None else list(source.latent)},
        "bsdf": result.family.to_json(),
        "values": dict(result.values),
        "spectra": {"wavelengths_nm": list(wavelengths), "values": result.spectra}
        if result.spectra and wavelengths is not None
        else None,
        "mitsuba": bsdf_dict(result.family, result.values),
        "mitsuba_spectral": bsdf_dict(result.family, spectral, wavelengths) if result.spectra else None,
        "method": result.method,
        "metric": result.metric,
        "hyperparameters": result.hyperparameters,
        "residuals": result.residuals,
        "diffuse_residual": result.diffuse_residual,
        "spectral_residual": result.spectral_residual,
        "minima": [asdict(minimum) for minimum in result.minima],
        "statements": [asdict(statement) for statement in result.statements],
        "notes": list(result.notes),
        "n_pairs": result.n_pairs,
        "variant": result.variant,
        "seconds": result.seconds,
    }


def write(path: Path, result: FitResult, source: Source) -> None:
    """Write a fit. Raises: as `atomic.replacing`."""
    atomic.write_text(path, json.dumps(document(result, source), indent=2, allow_nan=False) + "\n")


def read(path: Path) -> dict[str, Any]:
    """The plain values of a written fit, checked against the schema.

    Raises:
        UsageError: there is no such file.
        FileFormatError: it is no fit, or an entry is missing or of the wrong type.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise UsageError(f"{path}: no such file; name the JSON of a fit") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FileFormatError(f"{path}: {error}, expected JSON; name the JSON of a fit") from error
    _check(content, schema(), path.name, "the document")
    return content


def read_bsdf(path: Path) -> Any:
    """Mitsuba's BSDF of a written fit, in the RGB variant of the backend.

    Raises:
        UsageError, FileFormatError: as `read`, or Mitsuba refuses the BSDF.
    """
    content = read(path)
    return load_bsdf(BsdfFamily.from_json(content["bsdf"]), content["values"])


@lru_cache(maxsize=1)
def schema() -> dict[str, Any]:
    """The JSON schema of a fit."""
    return json.loads(files("manifold").joinpath("data/fit.schema.json").read_text(encoding="utf-8"))


def _check(value: Any, rule: Mapping[str, Any], file: str, where: str) -> None:
    """Raise FileFormatError unless a value follows a schema of the words that ours uses."""
    expected = rule.get("type", [])
    names = [expected] if isinstance(expected, str) else expected
    kinds = tuple(kind for name in names for kind in _TYPES[name])
    if not isinstance(value, kinds) or (isinstance(value, bool) and "boolean" not in names):
        raise FileFormatError(f"{file}: {where} is {_short(value)}, expected {' or '.join(names)}; fit again")
    if "enum" in rule and value not in rule["enum"]:
        known = " or ".join(str(v) for v in rule["enum"])
        raise FileFormatError(f"{file}: {where} is {_short(value)}, expected {known}; fit again")
    if isinstance(value, dict):
        for name in rule.get("required", ()):
            if name not in value:
                raise FileFormatError(f"{file}: {where} has no {name!r}, expected one; fit again")
        for name, inner in rule.get("properties", {}).items():
            if name in value:
                _check(value[name], inner, file, f"{where}.{name}".removeprefix("the document."))
    if isinstance(value, list) and "items" in rule:
        for k, one in enumerate(value):
            _check(one, rule["items"], file, f"{where}[{k}]")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
