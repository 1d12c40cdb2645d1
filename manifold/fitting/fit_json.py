"""Fits as JSON: written with everything that made them, read back as BSDFs. Schema: `fit.schema.json`."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manifold import __version__
from manifold.fitting import fit_check
from manifold.fitting.bsdf_evaluation import bsdf_dict, load_bsdf
from manifold.fitting.bsdf_parameters import BsdfFamily
from manifold.system import atomic, reading

if TYPE_CHECKING:
    from manifold.fitting.principled import FitResult

FORMAT_VERSION = 1
PROGRAM = f"manifold {__version__}"


@dataclass(frozen=True)
class Source:
    """The source of a fit.

    Attributes:
        name: of the material.
        file, sha256: name and hash of the measured file; None for a prediction.
        latent, model, model_sha256: where a prediction comes from, the model's file and its hash; None for a file.
        colour: of a prediction, in words; None for a file, and where colours are fixed by latents.
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
    wavelengths, own = result.bands.wavelengths_nm, result.spectra
    known = asdict(result)
    del known["bands"]
    content = {
        "format": "manifold fit",
        "format_version": FORMAT_VERSION,
        "program": PROGRAM,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": asdict(source),
        "bsdf": known.pop("family"),
        "mitsuba": bsdf_dict(result.family, result.values),
        "mitsuba_spectral": bsdf_dict(result.family, result.values | own, wavelengths) if own else None,
    } | known
    content["spectra"] = {"wavelengths_nm": wavelengths, "values": own} if own else None
    return signed(json.loads(json.dumps(content, allow_nan=False)))  # lists for tuples, as it is read again


def signed(content: dict[str, Any]) -> dict[str, Any]:
    """Plain values with the hash by which later changes are found."""
    return content | {"sha256": _digest(content)}


def is_untouched(content: dict[str, Any]) -> bool:
    """Whether plain values are unchanged since `document` made them."""
    return content.get("sha256") == _digest(content)


def _digest(content: dict[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def write_document(path: Path, content: dict[str, Any]) -> None:
    """Write what `document` has made. Raises: as `atomic.replacing`."""
    atomic.write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read(path: Path) -> dict[str, Any]:
    """The plain values of a written fit, validated.

    Raises:
        UsageError: there is no such file.
        FileFormatError: it is no fit, an entry is missing or of the wrong type, or entries contradict each other.
    """
    content: dict[str, Any] = reading.read_json(path, "a .bsdf file or the JSON of a fit")
    fit_check.require_fit(content, path.name)
    return content


def read_bsdf(path: Path) -> Any:
    """Mitsuba's BSDF of a written fit, in the RGB variant of the backend.

    Raises:
        UsageError, FileFormatError: as `read`, or Mitsuba refuses the BSDF.
    """
    content = read(path)
    return load_bsdf(BsdfFamily.from_json(content["bsdf"]), content["values"])
