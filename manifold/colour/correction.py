"""Colour correction of one instrument to another: polynomials of three bands, and their JSON file.

Errors are relative, so that highlights do not dominate. Values larger than those to which a polynomial was fitted are
scaled down, corrected and scaled up again, because higher terms would extrapolate wildly.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__
from manifold.colour.colour_science import colour_science
from manifold.colour.conversion import interpolation_matrix, to_srgb, to_xyz, xyz_weights
from manifold.colour.difference import delta_e_2000_lab, to_lab
from manifold.colour.narrow_bands import SPECTRUM, estimate_spectra, is_narrow
from manifold.core import disk
from manifold.core.defaults import DARKEST
from manifold.core.disk import read_json
from manifold.core.errors import FileFormatError, UsageError
from manifold.core.records import Array, Bands, Indices, Mask, plain

_FORMAT = "manifold colour correction"
_LEAST_KEPT = 1e-8  # of what a left-out sample says, the share that the others must determine
_MOST_WORSE = 0.25  # share of samples that a correction may make worse
FORMAT_VERSION = 1
_CHEUNG = {f"Cheung 2004, {terms} terms": terms for terms in (5, 7, 8, 10, 11, 14, 20)}
FORMS = ("linear", "root polynomial of degree 2", *_CHEUNG)
"""Forms of a correction, simplest first."""


def _terms(form: str, x: Array) -> Array:
    """Return the terms (n, T) of values x (n, 3)."""
    if form == "linear":
        return x
    of = colour_science().characterisation
    if form in _CHEUNG:
        return np.asarray(of.matrix_augmented_Cheung2004(x, _CHEUNG[form]))
    return np.asarray(of.polynomial_expansion_Finlayson2015(x, 2, True))


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """A conversion from three bands of one instrument to B bands of a reference.

    Attributes:
        form: one of `FORMS`.
        matrix: coefficients of the terms, shape (T, B).
        scale: values are divided by it before the terms are computed.
        largest: norm of the largest divided values to which the correction was fitted.
        errors: relative leave-one-out error of every form that was tried; NaN if there are too few values.
        uncorrected: the relative error of spectra that are estimated without a correction (see `narrow_bands`); NaN
            if the bands are not blue, green and red.
        colours: CIEDE2000 of each of S specimens without a correction (NaN as above) and with a correction fitted
            to the others, shape (S, 2), means over its readings; not part of the file.

    Source: Cheung, Westland, Connah & Ripamonti 2004; Finlayson, Mackiewicz & Hurlbert 2015.
    """

    source: Bands
    reference: Bands
    form: str
    matrix: Array
    scale: float
    largest: float
    errors: dict[str, float]
    uncorrected: float = float("nan")
    colours: Array = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def is_worse(self) -> Mask:
        """Return a mask of the specimens whose colours are worse with the correction than without, bool (S,)."""
        return np.asarray(self.colours[:, 1] > self.colours[:, 0])

    def apply(self, x: Array) -> Array:
        """Return the corrected values (n, B) of values x (n, 3), never negative."""
        x = np.asarray(x, dtype=np.float64) / self.scale
        beyond = np.maximum(np.linalg.norm(x, axis=1, keepdims=True) / self.largest, 1.0)
        terms = _terms(self.form, np.maximum(x / beyond, 0.0))
        return np.asarray(np.maximum(terms @ self.matrix * beyond * self.scale, 0.0))

    def is_beyond(self, x: Array) -> Mask:
        """Return whether values (n, 3) are larger than all values that the correction was fitted to, bool (n,)."""
        return np.asarray(np.linalg.norm(x / self.scale, axis=1) > self.largest)

    def to_json(self) -> dict[str, Any]:
        """Return plain values; None for an error that could not be measured."""
        names = ("form", "matrix", "scale", "largest", "errors", "uncorrected")
        return plain({name: getattr(self, name) for name in names})


def learn_correction(
    x: Array,
    y: Array,
    source: Bands,
    reference: Bands,
    *,
    forms: Sequence[str] = FORMS,
    groups: Indices | None = None,
) -> ColourCorrection:
    """Fit the correction from x (n, 3), at least 0, to y (n, B) that has the smallest leave-one-out error.

    With `groups` (n,), whole specimens are left out. A form is tried only if its terms are determined when any
    specimen is left out. The result is the best form among those that worsen at most a quarter of the specimens,
    or, if there is none, the best among those that worsen the fewest.
    """
    x, y = np.maximum(np.asarray(x, np.float64), 0.0), np.asarray(y, np.float64)
    if len(x) < 4 or not x.max() > 0.0:
        raise UsageError(
            f"the instruments share {len(x)} directions, expected at least four with values above 0 to learn a "
            "colour correction"
        )
    scale = float(x.max())
    unit, wanted = x / scale, y / scale
    weight = 1.0 / (np.linalg.norm(wanted, axis=1) + DARKEST)[:, None]
    groups = np.arange(len(x), dtype=np.intp) if groups is None else groups
    most_left_out = int(np.unique(groups, return_counts=True)[1].max())
    estimated, seen_bands = _estimated(unit, source), source if source.is_rgb else SPECTRUM
    before = (
        np.full(groups.max() + 1, np.nan)
        if estimated is None
        else _sample_colours(scale * estimated, seen_bands, y, reference, groups)
    )
    errors: dict[str, float] = {}
    colours: dict[str, Array] = {}
    for form in forms:
        terms = _terms(form, unit)
        if terms.shape[1] >= len(x) - most_left_out:
            continue
        wrong = _left_out(terms * weight, wanted * weight, groups)
        if wrong is not None:
            errors[form] = float(np.sqrt(np.mean(np.sum(wrong**2, axis=1))))
            made = scale * np.maximum(wanted - wrong / weight, 0.0)
            colours[form] = np.column_stack([before, _sample_colours(made, reference, y, reference, groups)])
    if not errors:
        errors["linear"] = float("nan")
        colours["linear"] = np.column_stack([before, np.full(len(before), np.nan)])
    share = {form: float(np.mean(of[:, 1] > of[:, 0])) for form, of in colours.items()}
    least = max(min(share.values()), _MOST_WORSE)
    best = min((form for form in errors if share[form] <= least), key=lambda form: (errors[form], len(form)))
    matrix = np.linalg.lstsq(_terms(best, unit) * weight, wanted * weight, rcond=None)[0]
    largest = float(np.linalg.norm(unit, axis=1).max())
    uncorrected = float("nan") if source.is_rgb else _uncorrected_error(estimated, wanted, weight, reference)
    return ColourCorrection(
        source, reference, best, matrix, scale, largest, errors, uncorrected, colours[best]
    )  # fmt: skip


def _estimated(x: Array, source: Bands) -> Array | None:
    """Return the colours of x (n, 3) without a correction, or None.

    Linear sRGB is returned unchanged, and narrow bands as estimated spectra.
    """
    if source.is_rgb:
        return x
    return estimate_spectra(x, source) if is_narrow(source) else None


def _sample_colours(f: Array, bands: Bands, wanted: Array, reference: Bands, samples: Indices) -> Array:
    """Return the mean CIEDE2000 (D65) of every sample between f (n, B) and the reference (n, B_r), shape (S,)."""
    labs = [
        to_lab(to_xyz(np.pi * values, axis), xyz_weights(axis).sum(axis=0))
        for values, axis in ((f, bands), (wanted, reference))
    ]
    off = delta_e_2000_lab(*labs)
    return np.asarray(np.bincount(samples, off) / np.bincount(samples))


def _uncorrected_error(spectra: Array | None, wanted: Array, weight: Array, reference: Bands) -> float:
    """Return the root mean square relative error of estimated spectra (n, B_s), at the bands of the reference."""
    if spectra is None:
        return float("nan")
    if reference.wavelengths_nm is None:
        made = to_srgb(spectra, SPECTRUM)
    else:
        at, nodes = np.array(reference.wavelengths_nm), np.array(SPECTRUM.wavelengths_nm)
        made = spectra @ interpolation_matrix(nodes, at).T
    return float(np.sqrt(np.mean(np.sum(((made - wanted) * weight) ** 2, axis=1))))


def _left_out(terms: Array, wanted: Array, groups: Indices) -> Array | None:
    """Return the residuals (shape of `wanted`) of groups that are predicted by fits to the other groups.

    None if, without a group, the others do not determine all terms.
    """
    inverse = np.linalg.pinv(terms)
    residual = wanted - terms @ (inverse @ wanted)
    for group in np.unique(groups):
        rows = np.flatnonzero(groups == group)
        kept = np.eye(len(rows)) - terms[rows] @ inverse[:, rows]
        if np.linalg.eigvalsh(0.5 * (kept + kept.T))[0] < _LEAST_KEPT:
            return None
        residual[rows] = np.linalg.solve(kept, residual[rows])
    return np.asarray(residual)


def write_correction(path: Path, correction: ColourCorrection) -> None:
    """Write a correction as a JSON file, atomically; wavelengths are in nm, or null for linear sRGB."""
    content = {
        "format": _FORMAT,
        "format_version": FORMAT_VERSION,
        "program": f"manifold {__version__}",
        "source_wavelengths_nm": correction.source.wavelengths_nm,
        "wavelengths_nm": correction.reference.wavelengths_nm,
    }
    disk.write_text(path, json.dumps(content | correction.to_json(), indent=1) + "\n")


def read_correction(path: Path) -> ColourCorrection:
    """Read a correction from a JSON file."""
    content = read_json(path, "a colour correction")
    try:
        return _from_json(content)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: not a colour correction ({error}), expected a file of `write_correction`"
        ) from error


def _from_json(content: Any) -> ColourCorrection:
    if content["format"] != _FORMAT or content["form"] not in FORMS:
        raise ValueError("its format or form is unknown")
    if content.get("format_version", FORMAT_VERSION) != FORMAT_VERSION:  # 0.1.0 wrote none
        raise ValueError(f"format version {content['format_version']}, expected {FORMAT_VERSION}")
    source, reference = (
        Bands(None if content[key] is None else tuple(float(nm) for nm in content[key]))
        for key in ("source_wavelengths_nm", "wavelengths_nm")
    )
    matrix = np.array(content["matrix"], dtype=np.float64)
    shape = _terms(content["form"], np.ones((1, 3))).shape[1], reference.count
    if matrix.shape != shape or not np.all(np.isfinite(matrix)):
        raise ValueError(f"its matrix has shape {matrix.shape}, expected {shape} of finite numbers")
    scale, largest = float(content["scale"]), float(content["largest"])
    if not (0.0 < scale < np.inf and 0.0 < largest < np.inf):
        raise ValueError("its scale or largest value is not positive")
    errors = {str(form): np.nan if e is None else float(e) for form, e in content["errors"].items()}
    uncorrected = content.get("uncorrected")
    uncorrected = np.nan if uncorrected is None else float(uncorrected)
    return ColourCorrection(source, reference, content["form"], matrix, scale, largest, errors, uncorrected)
