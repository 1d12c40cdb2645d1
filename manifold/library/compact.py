"""The compact form of a material: quantised spectral components of its cube roots, within a bound on the visible error.

The cube roots of a material's values, with the luminance as one more band, are projected on the principal components
of the material's own spectra and rounded to multiples of one step. The differences between neighbouring cells are
stored, because they compress well. Cells without a value stay empty. `vndf` is kept to four digits, and every other
field unchanged. `manifold.library.compacting` finds the step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manifold.core.compiled import loops
from manifold.core.records import AnyArray
from manifold.library import visible_normals
from manifold.library.identity import Accuracy
from manifold.library.layout import compressed_bytes, pack

EXTRA = "extra "
"""Prefix of the names of fields that this package does not interpret."""

_MOST_VALUES = 1 << 28  # values of spectra; the largest measured materials have a tenth


@dataclass(frozen=True, eq=False)
class Compact:
    """The compact form of a material.

    Attributes:
        coefficients: multiples of a step, as differences along rows and columns, int32, shape (K, P, T, H, W).
        tables: arrays by name: `step`; `basis` (K, B + 1), whose last band is the luminance; `is_nonnegative`; the
            arrays from which `visible_normals` restores `vndf`; and the fields that are stored unchanged.
        accuracy: errors of the decoded material.
    """

    coefficients: NDArray[np.int32]
    tables: dict[str, AnyArray]
    accuracy: Accuracy

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """Return all arrays by name."""
        return {"coefficients": self.coefficients, **self.tables}

    @property
    def stored_bytes(self) -> int:
        """Return the bytes of all arrays as a library stores them."""
        return compressed_bytes(self.coefficients) + compressed_bytes(pack(self.tables)[0])

    def decode(self) -> dict[str, Any]:
        """Return the array fields of the decoded `BsdfFile`, by name."""
        return decode(self.coefficients, self.tables)


def decode(coefficients: NDArray[np.int32], tables: Mapping[str, AnyArray]) -> dict[str, Any]:
    """Return the array fields of a `BsdfFile`, by name, decoded from the arrays of a `Compact`.

    Raises LookupError or ValueError.
    """
    tables = dict(tables)
    slices = visible_normals.Slices(*(tables.pop(name) for name in visible_normals.Slices._fields))
    difference, step = tables.pop("vndf_difference"), tables.pop("step")
    basis = (tables.pop("basis") * step).astype(np.float32)
    least = 0.0 if tables.pop("is_nonnegative")[0] else -np.inf
    if coefficients.ndim != 5 or basis.ndim != 2 or len(coefficients) != len(basis) or basis.shape[1] < 2:
        raise ValueError(
            f"coefficients {coefficients.shape} with a basis {basis.shape}, expected (K, P, T, H, W) with (K, B + 1)"
        )
    (count, *shape), n_bands = coefficients.shape, basis.shape[1] - 1
    if math.prod(shape) * n_bands > _MOST_VALUES:
        raise ValueError(f"{math.prod(shape) * n_bands} values, expected at most {_MOST_VALUES}")
    slices_of = np.ascontiguousarray(coefficients, np.int32).reshape(count, -1, *shape[2:])
    spectra, luminance = (np.empty((*slices_of.shape[1:], n), np.float32) for n in (n_bands, 1))
    loops.dequantise(slices_of, basis[:, :-1], least, spectra)
    loops.dequantise(slices_of, basis[:, -1:], 0.0, luminance)
    extra = {name: tables.pop(name) for name in list(tables) if name.startswith(EXTRA)}
    return {
        **tables,
        "vndf": visible_normals.decode(difference, slices, tables["ndf"], tables["phi_i_rad"]),
        "luminance": luminance.reshape(shape),
        "spectra": np.moveaxis(spectra.reshape(*shape, n_bands), -1, 2),
        "extra": MappingProxyType({name.removeprefix(EXTRA): array for name, array in extra.items()}),
    }
