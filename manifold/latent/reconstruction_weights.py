"""The best non-negative combination of any number of atoms, band by band."""

from __future__ import annotations

import numpy as np

from manifold.latent.nonnegative import nonnegative_weights
from manifold.records import Array
from manifold.system.parallel import one_blas_thread

_OF_VALUES = 0.5  # how much the error of values counts beside that of pixels
_LEAST = 216.0 / 24389.0  # of display white: CIELAB is linear below
_FITS = 2  # the second with the slopes of the first
_AT_ONCE = 16  # atoms that enter together
_TOLERANCE = 1e-9  # of slopes, relative to the norm of the target


def reconstruction_weights(atoms: Array, material: Array, n_pixels: int) -> Array:
    """Weights v >= 0 of atoms by which `v g` looks most like every band of a material.

    Minimises `E_1 / 4 + E_2`, where E_1 is the squared cube-root error of the values
    `sum (x*^(1/3) - x^(1/3))^2 / sum x^(2/3)`, x being `cos(theta_i) cos(theta_o) f`, and E_2 that of pixels. Sums run
    over all bands. Pixels brighter than display white do not count; cube roots are linear below 0.9 % of it, as in
    CIELAB.

    Differences of cube roots are those of values times slopes: linear least squares, repeated with better slopes.

    Args:
        atoms: values of BRDFs, cosines included, at direction pairs, then their pixels, never negative: shape (n, R).
        material: the same of the material's bands, shape (B, R).
        n_pixels: how many of the R are pixels, where display white is 1.
    Returns:
        Shape (B, n), mostly zeros.
    Source: docs/explanation/reconstruction.md.
    """
    material = np.maximum(material, 0.0)
    weights: Array = np.zeros((len(material), len(atoms)))
    fitted = material
    with one_blas_thread:
        for _ in range(_FITS):
            slopes = cube_root_slopes(material, n_pixels, fitted)
            v = weights[0]
            for b, (x, slope) in enumerate(zip(material, slopes, strict=True)):
                # From the fit before, or from the band before: neighbouring bands are alike.
                v = _fit(atoms * slope, x * slope, weights[b] if np.any(weights[b]) else v)
                weights[b] = v
            fitted = weights @ atoms
    return weights


def cube_root_slopes(material: Array, n_pixels: int, fitted: Array) -> Array:
    """By what to multiply errors of values so that their squares sum up to what `reconstruction_weights` minimises.

    Args:
        material: shape (B, R), at least 0.
        n_pixels: as for `reconstruction_weights`.
        fitted: values (B, R) near which errors are; where they are the material's, slopes are derivatives.
    """
    is_pixel = np.arange(material.shape[1]) >= material.shape[1] - n_pixels
    counts = np.where(is_pixel & (material >= 1.0), 0.0, 1.0)
    norms = [np.sum(counts[:, k] * material[:, k] ** (2.0 / 3.0)) for k in (~is_pixel, is_pixel)]
    of_values, of_pixels = 1.0 / np.sqrt(np.maximum(norms, _LEAST))
    a, b = np.cbrt(material), np.cbrt(fitted)
    secant = np.maximum(a * a + a * b + b * b, 3.0 * _LEAST ** (2.0 / 3.0))
    return np.asarray(counts * np.where(is_pixel, of_pixels, _OF_VALUES * of_values) / secant)


def _fit(A: Array, y: Array, start: Array) -> Array:
    """Weights v >= 0 (n,) that minimise `|v A - y|`: atoms enter by their slopes, a few at a time."""
    norms = np.maximum(np.linalg.norm(A, axis=1), np.finfo(float).tiny)
    limit = _TOLERANCE * np.linalg.norm(y)
    used = np.flatnonzero(start)
    while True:
        some, v = A[used], np.zeros(len(A))
        if used.size:
            v[used] = nonnegative_weights(some @ some.T, (some @ y)[None])[0]
        slopes = A @ (y - v[used] @ some) / norms
        slopes[used] = 0.0
        enter = np.argsort(-slopes)[:_AT_ONCE]
        enter = enter[slopes[enter] > limit]
        if enter.size == 0:
            return v
        used = np.union1d(used, enter)
