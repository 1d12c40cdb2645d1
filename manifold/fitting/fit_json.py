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
from manifold.rendering.plugin_names import require_plugins, types_of
from manifold.system import atomic, small_files

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
    wavelengths = result.bands.wavelengths_nm
    spectral = dict(result.values) | result.spectra
    content = {
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
    return signed(content)


def signed(content: dict[str, Any]) -> dict[str, Any]:
    """Plain values with the hash that tells later whether somebody changed them."""
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
    """The plain values of a written fit, checked as in `fit_check.require_fit`.

    Raises:
        UsageError: there is no such file.
        FileFormatError: it is no fit, an entry is missing or of the wrong type, or entries contradict each other.
    """
    content = small_files.read_json(path, "the JSON of a fit")
    fit_check.require_fit(content, path.name)
    require_plugins(types_of([content["mitsuba"], content["mitsuba_spectral"]]), path.name)
    return content


def read_bsdf(path: Path) -> Any:
    """Mitsuba's BSDF of a written fit, in the RGB variant of the backend.

    Raises:
        UsageError, FileFormatError: as `read`, or Mitsuba refuses the BSDF.
    """
    content = read(path)
    return load_bsdf(BsdfFamily.from_json(content["bsdf"]), content["values"])
