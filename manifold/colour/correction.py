"""Colour correction of one instrument to another: polynomials of its bands.

Errors are relative, so highlights do not rule. Beyond the values it was learned at, a polynomial is continued in
proportion, since its higher terms explode there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from manifold.colour.tables import colour_science
from manifold.errors import UsageError
from manifold.records import Array

_LEAST = 1e-3  # of the largest value: what is darker counts as this dark


def _expansions() -> dict[str, Callable[[Array], Array]]:
    """Functions from three bands (n, 3) to terms (n, T), simplest first."""
    of = colour_science().characterisation

    def cheung(terms: int) -> Callable[[Array], Array]:
        return lambda x: np.asarray(of.matrix_augmented_Cheung2004(x, terms))

    return {
        "linear": lambda x: x,
        "root polynomial of degree 2": lambda x: np.asarray(
            of.polynomial_expansion_Finlayson2015(x, 2, True)
        ),
        **{f"Cheung 2004, {terms} terms": cheung(terms) for terms in (5, 7, 8, 10, 11, 14, 20)},
    }


FORMS = (
    "linear",
    "root polynomial of degree 2",
    *(f"Cheung 2004, {terms} terms" for terms in (5, 7, 8, 10, 11, 14, 20)),
)


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """From three bands of one instrument to B bands of another.

    Attributes:
        form: one of `FORMS`.
        matrix: of the terms, shape (T, B).
        scale: by which values are divided before terms are made of them.
        largest: norm of the largest of these that it was learned at.
        errors: relative, left out one by one, of every form that was tried; NaN where there are too few values.

    Source: Cheung, Westland, Connah & Ripamonti 2004; Finlayson, Mackiewicz & Hurlbert 2015.
    """

    form: str
    matrix: Array
    scale: float
    largest: float
    errors: dict[str, float]

    @staticmethod
    def terms_of(form: str) -> int:
        """Number of terms of a form."""
        return int(_expansions()[form](np.ones((1, 3))).shape[1])

    def apply(self, x: Array) -> Array:
        """Corrected values (n, B) of values x (n, 3), never negative."""
        x = np.asarray(x, dtype=np.float64) / self.scale
        beyond = np.maximum(np.linalg.norm(x, axis=1, keepdims=True) / self.largest, 1.0)
        terms = _expansions()[self.form](np.maximum(x / beyond, 0.0))
        return np.maximum(terms @ self.matrix * beyond * self.scale, 0.0)

    def is_beyond(self, x: Array) -> Array:
        """Whether values (n, 3) are larger than any of the samples it was learned from, bool (n,)."""
        return np.linalg.norm(np.asarray(x) / self.scale, axis=1) > self.largest

    def to_json(self) -> dict[str, Any]:
        """Plain values; None for an error that could not be measured."""
        errors = {form: None if np.isnan(error) else error for form, error in self.errors.items()}
        return {
            "form": self.form, "matrix": self.matrix.tolist(), "scale": self.scale, "largest": self.largest,
            "errors": errors,
        }  # fmt: skip


def learn_correction(
    x: Array, y: Array, forms: Sequence[str] = FORMS, groups: Array | None = None
) -> ColourCorrection:
    """The correction that is best on values left out; only forms with fewer terms than values are tried.

    Args:
        x: of the instrument to correct, at least 0, shape (n, 3).
        y: of the reference at the same places, shape (n, B).
        forms: which to try.
        groups: of which sample each value is, shape (n,): they are left out sample by sample; by default one by one.
    Raises:
        UsageError: fewer than four places, or all values are zero.
    """
    x, y = np.maximum(np.asarray(x, np.float64), 0.0), np.asarray(y, np.float64)
    if len(x) < 4 or not x.max() > 0.0:
        raise UsageError(
            f"{len(x)} directions are shared, expected four or more with light to learn a colour correction from"
        )
    scale = float(x.max())
    unit, target = x / scale, y / scale
    weight = 1.0 / (np.linalg.norm(target, axis=1) + _LEAST)
    known = _expansions()
    errors: dict[str, float] = {}
    groups = np.arange(len(x)) if groups is None else np.asarray(groups)
    largest = int(np.unique(groups, return_counts=True)[1].max())
    for form in forms:
        terms = known[form](unit)
        if terms.shape[1] < len(x) - largest:
            errors[form] = _left_out(terms * weight[:, None], target * weight[:, None], groups)
    if not errors:
        errors["linear"] = float("nan")
    best = min(errors, key=lambda form: (errors[form], len(form)))
    terms = known[best](unit)
    matrix = np.linalg.lstsq(terms * weight[:, None], target * weight[:, None], rcond=None)[0]
    return ColourCorrection(best, matrix, scale, float(np.linalg.norm(unit, axis=1).max()), errors)


def _left_out(terms: Array, target: Array, groups: Array) -> float:
    """Root mean square of what least squares miss, each group by a fit to the others."""
    inverse = np.linalg.pinv(terms)
    missed = target - terms @ (inverse @ target)
    total = 0.0
    for group in np.unique(groups):
        rows = np.flatnonzero(groups == group)
        kept = np.eye(len(rows)) * (1.0 + 1e-9) - terms[rows] @ inverse[:, rows]
        total += float(np.sum(np.linalg.solve(kept, missed[rows]) ** 2))
    return float(np.sqrt(total / len(target)))
