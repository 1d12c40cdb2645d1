"""Other ways to complete a BRDF from a few readings, with the readings and the library of `manifold complete`.

Each takes `Problem` and returns f in 1/sr at the pairs where it is judged, (P, B). Materials of the library are single
bands: every channel of every file is a sample, as Nielsen et al. take them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import values_at
from manifold.core.directions import half_vector
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import fit_bsdf

_EPSILON = 1e-3  # of the logarithm, in 1/sr, as Nielsen et al.
_ROUGHNESS = np.geomspace(0.02, 1.0, 40)  # of the fitted lobe
_REWEIGHTED = 8  # rounds of the fit of cube roots
_F0 = 0.04  # reflectance of a dielectric; the strength of the lobe is free


@dataclass(frozen=True, eq=False)
class Problem:
    """Readings f (R, B) in 1/sr at R pairs, the pairs at which a completion is judged, and the library's materials."""

    read: Pairs
    values: Array
    bands: Bands
    judged: Pairs
    materials: Sequence[BRDF]

    def samples(self, pairs: Pairs) -> Array:
        """Values of all bands of all materials, at least 0, shape (P, n)."""
        return np.maximum(np.hstack([values_at(material, pairs) for material in self.materials]), 0.0)


@dataclass(frozen=True)
class RidgeMapping:
    """The mapping of values times cosines in which the components are linear, and the candidate ridge weights."""

    forward: Callable[[Array], Array]
    inverse: Callable[[Array], Array]
    weights: Array


LOGARITHMS = RidgeMapping(
    lambda f: np.log(f + _EPSILON),
    lambda y: np.maximum(np.exp(y) - _EPSILON, 0.0),
    np.geomspace(0.1, 1000.0, 17),  # Nielsen et al. have 40 for MERL
)
CUBE_ROOTS = RidgeMapping(np.cbrt, lambda y: np.maximum(y, 0.0) ** 3, np.geomspace(1e-4, 10.0, 21))


def ridge_on_components(
    samples: Sequence[Array], cosines: Sequence[Array], values: Array, mapping: RidgeMapping
) -> Array:
    """Predict f by ridge regression on all principal components of mapped values, band by band.

    All components take part, so they need not be computed: the centred samples themselves give the same f. The weight
    of the coefficients has the lowest error of left-out readings, over all bands; Nielsen et al. chose it so over MERL.
    Their reference, the median of the samples, cancels when the mean of the samples is subtracted.

    Args:
        samples: values of single bands of the library, (P, n): at the pairs of the readings, and where f is predicted.
        cosines: products of both cosines at these pairs, each (P,).
        values: readings (R, B), in 1/sr.
        mapping: `LOGARITHMS` for the published method.
    Returns:
        f in 1/sr, (P, B).
    Source: Nielsen, Jensen & Ramamoorthi 2015, eq. 2 to 6.
    """
    amplitudes = [np.maximum(each, 1e-3)[:, None] for each in cosines]
    mapped = [mapping.forward(f * a) for f, a in zip(samples, amplitudes, strict=True)]
    means = [each.mean(axis=1, keepdims=True) for each in mapped]
    read, judged = (each - mean for each, mean in zip(mapped, means, strict=True))
    y = mapping.forward(np.maximum(values, 0.0) * amplitudes[0]) - means[0]
    inner = read @ read.T
    solved = [np.linalg.inv(inner + weight * np.eye(len(inner))) for weight in mapping.weights]
    # The residual of a left-out reading k is (A^-1 y)_k / (A^-1)_kk, A = X X^T + weight.
    left_out = [np.sum((inverse @ y / np.diag(inverse)[:, None]) ** 2) for inverse in solved]
    weights = read.T @ solved[int(np.argmin(left_out))] @ y
    return mapping.inverse(judged @ weights + means[1]) / amplitudes[1]


def _pca_ridge(mapping: RidgeMapping) -> Callable[[Problem], Array]:
    """Ridge regression with the weight by leave-one-out over the readings."""

    def complete(problem: Problem) -> Array:
        places = problem.read, problem.judged
        samples, cosines = [problem.samples(pairs) for pairs in places], [pairs.cosines for pairs in places]
        return ridge_on_components(samples, cosines, problem.values, mapping)

    return complete


def nearest(problem: Problem) -> Array:
    """The sample of the library whose cube roots, times a gain per band, are nearest to the readings."""
    roots = np.cbrt(problem.samples(problem.read))  # [R, n]
    target = np.cbrt(np.maximum(problem.values, 0.0))  # [R, B]
    weight = np.cbrt(problem.read.cosines)[:, None]
    roots, target = weight * roots, weight * target
    gains = (roots.T @ target) / np.maximum(np.sum(roots**2, axis=0), 1e-30)[:, None]  # [n, B]
    misfit = np.sum(target**2) - np.sum(gains**2 * np.sum(roots**2, axis=0)[:, None], axis=1)
    best = int(np.argmin(misfit))
    return problem.samples(problem.judged)[:, best : best + 1] * gains[best] ** 3


def lobe(pairs: Pairs, alpha: float) -> Array:
    """A GGX lobe with Schlick's Fresnel term and uncorrelated masking, (P,)."""
    h = half_vector(pairs.wi, pairs.wo)
    cos_i, cos_o, cos_h = pairs.wi[:, 2], pairs.wo[:, 2], h[:, 2]
    cos_d = np.clip(np.sum(pairs.wi * h, axis=1), 0.0, 1.0)
    a2 = alpha * alpha
    D = a2 / (np.pi * (1.0 + cos_h**2 * (a2 - 1.0)) ** 2)

    def masking(c: Array) -> Array:
        return 2.0 * c / (c + np.sqrt(a2 + (1.0 - a2) * c * c))

    fresnel = _F0 + (1.0 - _F0) * (1.0 - cos_d) ** 5
    return D * fresnel * masking(cos_i) * masking(cos_o) / np.maximum(4.0 * cos_i * cos_o, 1e-9)


def lambert_and_lobe(problem: Problem) -> Array:
    """A Lambertian and one GGX lobe of one roughness, each with a strength per band, fitted by cube roots."""
    target = np.cbrt(np.maximum(problem.values, 0.0))
    best: tuple[float, float, Array] | None = None
    for alpha in _ROUGHNESS:
        columns = np.stack([np.full(len(problem.read), 1.0 / np.pi), lobe(problem.read, alpha)], axis=1)
        strengths, misfit = [], 0.0
        for band in range(target.shape[1]):
            t, p = target[:, band], np.full(len(target), np.mean(target[:, band]))
            # p^(1/3) - t = (p - t^3) / (p^(2/3) + p^(1/3) t + t^2): least squares of cube roots by weights.
            for _ in range(_REWEIGHTED):
                weight = 1.0 / np.maximum(p * p + p * t + t * t, 1e-6)
                strength, _ = scipy.optimize.nnls(columns * weight[:, None], t**3 * weight)
                p = np.cbrt(columns @ strength)
            strengths.append(strength)
            misfit += float(np.sum((np.cbrt(columns @ strength) - target[:, band]) ** 2))
        if best is None or misfit < best[0]:
            best = misfit, alpha, np.array(strengths).T
    assert best is not None
    _, alpha, strengths = best
    return (
        np.stack([np.full(len(problem.judged), 1.0 / np.pi), lobe(problem.judged, alpha)], axis=1) @ strengths
    )


def lambert(problem: Problem) -> Array:
    """The mean of the readings everywhere."""
    return np.tile(problem.values.mean(axis=0), (len(problem.judged), 1))


def principled(problem: Problem) -> Array:
    """Mitsuba's principled fitted to the readings: shared parameters in sRGB, then a base colour per band."""
    read = problem.read
    bands = problem.bands
    samples = FitSamples.from_arrays(read.wi, read.wo, problem.values, bands=bands)
    return fit_bsdf(samples).brdf.eval(problem.judged.wi, problem.judged.wo)


def half_vector_coordinates(pairs: Pairs) -> Array:
    """Square roots of half-vector elevations, and difference angles, in radians, (P, 2)."""
    half = half_vector(pairs.wi, pairs.wo)
    cosines = half[:, 2], np.sum(pairs.wi * half, axis=1)
    elevation, difference = (np.arccos(np.clip(c, -1.0, 1.0)) for c in cosines)
    return np.stack([np.sqrt(elevation), difference], axis=1)


def aspecular_coordinates(pairs: Pairs) -> Array:
    """Aspecular angles, positive towards the normal, and incidences, in radians, (P, 2), in the plane of incidence."""
    incidence = np.arctan2(-pairs.wi[:, 0], pairs.wi[:, 2])
    return np.stack([incidence - np.arctan2(pairs.wo[:, 0], pairs.wo[:, 2]), incidence], axis=1)


def gaussian_process_of_one(
    read: Pairs,
    values: Array,
    judged: Pairs,
    coordinates: Callable[[Pairs], Array] = half_vector_coordinates,
) -> Array:
    """Return f (P, B) of a Gaussian process of the readings (R, B), without other materials.

    Cube roots of f over coordinates, with a squared exponential whose length scales and noise maximise the likelihood:
    the idea of 10.1145/3806194 for few readings.
    """
    kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF([0.4, 0.6], (0.1, 5.0)) + WhiteKernel(1e-3, (1e-6, 1e-1))
    process = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=2, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a length scale at its bound is no failure here
        process.fit(coordinates(read), np.cbrt(np.maximum(values, 0.0)))
    roots = np.asarray(process.predict(coordinates(judged))).reshape(len(judged), -1)
    return np.maximum(roots, 0.0) ** 3


def gaussian_process(problem: Problem) -> Array:
    """A Gaussian process of the readings."""
    return gaussian_process_of_one(problem.read, problem.values, problem.judged)


BASELINES: dict[str, Callable[[Problem], Array]] = {
    "pca_ridge": _pca_ridge(LOGARITHMS), "pca_ridge_of_cube_roots": _pca_ridge(CUBE_ROOTS), "nearest": nearest,
    "principled": principled, "gaussian_process": gaussian_process, "lambert_and_lobe": lambert_and_lobe,
    "lambert": lambert,
}  # fmt: skip
