"""Compiled loop that turns the stored coefficients of a compact material into its values."""

from __future__ import annotations

import numba as nb
import numpy as np


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def dequantise(coefficients, basis, least, values):
    """Cubes of sums of multiples of basis spectra.

    Args:
        coefficients: multiples as differences along rows and columns, int32, shape (K, S, H, W).
        basis: single precision, shape (K, B).
        least: of the sums.
        values: single precision, shape (S, H, W, B), written to.
    """
    n_slices, height, width, n_bands = values.shape
    row = np.empty(n_bands, np.float32)
    for s in range(n_slices):
        multiples = np.zeros((width, basis.shape[0]), np.int32)
        for i in range(height):
            for k in range(basis.shape[0]):
                left = np.int32(0)
                for j in range(width):
                    left += coefficients[k, s, i, j]
                    multiples[j, k] += left
            for j in range(width):
                row[:] = 0.0
                for k in range(basis.shape[0]):
                    if multiples[j, k] != 0:
                        multiple = np.float32(multiples[j, k])
                        for b in range(n_bands):
                            row[b] += multiple * basis[k, b]
                to = values[s, i, j]
                for b in range(n_bands):
                    root = max(row[b], least)
                    to[b] = root * root * root
