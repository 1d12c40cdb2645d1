"""Pearson's chi-square test of a BRDF's `sample` against its `pdf`."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from manifold.core.directions import from_spherical
from manifold.core.records import Array


def chi_square_p_value(
    brdf: Any,
    wi: Array,
    rng: np.random.Generator,
    *,
    n_samples: int = 200_000,
    n_theta: int = 40,
    n_phi: int = 80,
    order: int = 6,
    is_glossy: bool = False,
) -> float:
    """Probability of a misfit at least as large as the one seen, if `sample` does follow `pdf`.

    The samples are counted in cells of (theta, phi), plus one for those that came back with pdf 0. Expected
    counts integrate `pdf` over each cell by Gauss-Legendre, `order` points a side; what is missing from 1 is
    the expected number of invalid samples. Cells that expect fewer than 5 samples are pooled.

    Args:
        brdf: has `sample(wi, u)` and `pdf(wi, wo)`.
        wi: one direction, shape (3,).
        is_glossy: whether cells are as fine as sharp highlights around the mirror direction, where the density is
            steep.
    Returns:
        The p-value: below 1e-3 or so, divided by the number of tests made, it speaks against the sampling.
    """
    wo, density = brdf.sample(np.broadcast_to(wi, (n_samples, 3)), rng.random((n_samples, 2)))
    wo = wo[density > 0]
    theta = np.arccos(np.clip(wo[:, 2], -1.0, 1.0))
    phi = np.arctan2(wo[:, 1], wo[:, 0]) % (2.0 * np.pi)
    edges = np.linspace(0.0, np.pi / 2, n_theta + 1), np.linspace(0.0, 2.0 * np.pi, n_phi + 1)
    if is_glossy:
        edges = (
            _refined(edges[0], np.arccos(wi[2])),
            _refined(edges[1], (np.arctan2(wi[1], wi[0]) + np.pi) % (2 * np.pi)),
        )
    counts, _, _ = np.histogram2d(theta, phi, bins=edges)
    probability = cell_probabilities(brdf, wi, edges[0], edges[1], order)
    # An integral a little off 1 in the last digits must not become a negative number of invalid samples.
    invalid = max(1.0 - probability.sum(), 0.0)
    observed = np.append(counts.ravel(), n_samples - wo.shape[0])
    expected = n_samples * np.append(probability.ravel(), invalid)
    return _p_value(observed, expected)


def _refined(edges: Array, middle: float) -> Array:
    """Edges, and finer ones around an angle in radians."""
    steps = np.geomspace(1e-3, 0.3, 24)
    fine = middle + np.concatenate([-steps, [0.0], steps])
    return np.unique(np.concatenate([edges, fine[(fine > edges[0]) & (fine < edges[-1])]]))


def cell_probabilities(brdf: Any, wi: Array, theta: Array, phi: Array, order: int = 6) -> Array:
    """Integral of `pdf(wi, .)` over each cell between the edges, shape (len(theta) - 1, len(phi) - 1)."""
    x, w = np.polynomial.legendre.leggauss(order)
    t = (theta[:-1, None] + 0.5 * (x + 1.0) * np.diff(theta)[:, None]).ravel()
    p = (phi[:-1, None] + 0.5 * (x + 1.0) * np.diff(phi)[:, None]).ravel()
    pdf = brdf.pdf(wi, from_spherical(t[:, None], p[None, :])) * np.sin(t)[:, None]
    cells = pdf.reshape(theta.size - 1, order, phi.size - 1, order)
    area = 0.25 * np.diff(theta)[:, None] * np.diff(phi)[None, :]
    return np.einsum("iajb,a,b->ij", cells, w, w) * area


def _p_value(observed: Array, expected: Array) -> float:
    order = np.argsort(expected)
    observed, expected = observed[order], expected[order]
    small = int(np.searchsorted(expected, 5.0))
    pooled_observed, pooled_expected = observed[:small].sum(), expected[:small].sum()
    observed, expected = observed[small:], expected[small:]
    if pooled_expected >= 5.0 or observed.size == 0:
        observed, expected = np.append(observed, pooled_observed), np.append(expected, pooled_expected)
    elif pooled_observed > 0:
        # too little is expected there for a cell of its own: the smallest remaining cell takes it
        observed[0] += pooled_observed
        expected[0] += pooled_expected
    statistic = float(np.sum((observed - expected) ** 2 / np.maximum(expected, 1e-12)))
    return float(stats.chi2.sf(statistic, max(observed.size - 1, 1)))
