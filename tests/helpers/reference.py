"""Slow, obvious reference code that tests compare against."""

from __future__ import annotations

import math

import numpy as np

RADIAL = {  # of r, the distance in length scales
    "se": lambda r: math.exp(-(r**2) / 2),
    "matern32": lambda r: (1 + math.sqrt(3) * r) * math.exp(-math.sqrt(3) * r),
    "matern52": lambda r: (1 + math.sqrt(5) * r + 5 * r**2 / 3) * math.exp(-math.sqrt(5) * r),
    "cauchy": lambda r: 1 / (1 + r**2),
}


def covariance(x, x_prime, mu, length_scale, radial=RADIAL["se"]):
    """A radial kernel plus delta, one pair of points."""
    delta = 1.0 if all(a == b for a, b in zip(x, x_prime, strict=True)) else 0.0
    return mu * delta + radial(math.dist(x, x_prime) / length_scale)


def covariance_matrix(A, B, mu, length_scale, radial=RADIAL["se"]):
    """All pairs by two loops."""
    return np.array([[covariance(a, b, mu, length_scale, radial) for b in B] for a in A])


def posterior(X, Y, X_new, mu, length_scale):
    """Mean (M, D) and variance factor (M,) of the textbook posterior, by plain inversion."""
    K_inverse = np.linalg.inv(covariance_matrix(X, X, mu, length_scale))
    mean_Y = Y.mean(axis=0)
    means, variances = [], []
    for x in X_new:
        k = covariance_matrix([x], X, mu, length_scale)[0]
        means.append(mean_Y + k @ K_inverse @ (Y - mean_Y))
        variances.append(covariance(x, x, mu, length_scale) - k @ K_inverse @ k)
    return np.array(means), np.array(variances)


def gplvm_objective(X, Y, mu, length_scale, radial=RADIAL["se"]):
    """Negative log likelihood per output, constants dropped, output variance profiled out."""
    N, D = Y.shape
    K = covariance_matrix(X, X, mu, length_scale, radial)
    Y_c = Y - Y.mean(axis=0)
    s2 = np.trace(np.linalg.inv(K) @ Y_c @ Y_c.T) / (N * D)
    return 0.5 * np.linalg.slogdet(K)[1] + 0.5 * N * math.log(s2)


def log_likelihood(X, Y, mu, length_scale):
    """Eq. 21 of Hikichi & Iwasaki for centred Y (N, D)."""
    K = covariance_matrix(X, X, mu, length_scale)
    N, D = Y.shape
    return (
        -0.5 * np.sum(Y * np.linalg.solve(K, Y))
        - 0.5 * D * np.linalg.slogdet(K)[1]
        - 0.5 * N * D * math.log(2.0 * math.pi)
    )


def both_sides_of_eq_15(X, Y, X_new, mu, length_scale):
    """Distance of every prediction from the nearest sample, and its bound, for centred Y (N, D)."""
    K = covariance_matrix(X, X, mu, length_scale)
    slope = math.exp(-0.5) * math.sqrt(2 * len(X)) / length_scale * np.linalg.cond(K) * np.linalg.norm(Y)
    means, _ = posterior(X, Y, X_new, mu, length_scale)
    sides = []
    for x, mean in zip(X_new, means, strict=True):
        i = min(range(len(X)), key=lambda k: math.dist(x, X[k]))
        sides.append((np.linalg.norm(mean - Y[i]), slope * math.dist(x, X[i])))
    return np.array(sides).T


def rusinkiewicz(theta_h, theta_d, phi_d):
    """Both directions of a pair whose half vector has azimuth 0."""
    h = np.array([math.sin(theta_h), 0.0, math.cos(theta_h)])
    d = np.array(
        [math.sin(theta_d) * math.cos(phi_d), math.sin(theta_d) * math.sin(phi_d), math.cos(theta_d)]
    )
    turn = np.array([[h[2], 0.0, h[0]], [0.0, 1.0, 0.0], [-h[0], 0.0, h[2]]])
    wi = turn @ d
    return wi, 2.0 * (wi @ h) * h - wi


def rmse(f, f_star):
    """Eq. 22 of Hikichi & Iwasaki by loops over direction pairs and bands."""
    total = 0.0
    for pair in range(f.shape[0]):
        for band in range(f.shape[1]):
            total += (f[pair, band] - f_star[pair, band]) ** 2
    return math.sqrt(total / f.shape[0])


def central_differences(function, x, step=1e-5):
    """Gradient of a scalar function of an array, one coordinate at a time."""
    gradient = np.zeros_like(x)
    for index in np.ndindex(x.shape):
        ahead, behind = x.copy(), x.copy()
        ahead[index] += step
        behind[index] -= step
        gradient[index] = (function(ahead) - function(behind)) / (2 * step)
    return gradient


def left_out(method, data, i):
    """The prediction of material i by an evaluation method: from the others, or by the one fit that serves all."""
    everything = np.arange(data.n_materials)
    return method.fit(data, np.delete(everything, i) if method.refits else everything)(i)


def blend_shares(x, X, length_scale):
    """Shares of samples at a place: `exp(-d^2 / (2 l^2)) / d^2`, less 3e-4 of the largest, of sum 1; 1 at a sample."""
    squared = [sum((a - b) ** 2 for a, b in zip(x, row, strict=True)) / length_scale**2 for row in X]
    if 0.0 in squared:
        return np.eye(len(X))[squared.index(0.0)]
    shares = np.array([math.exp(-s / 2) / s for s in squared])
    shares = np.maximum(shares / shares.max() - 3e-4, 0.0)
    return shares / shares.sum()


def expected_error(x, X, places, errors, length_scale):
    """The formulas of docs/explanation/expected-errors.md at a place: `c` fitted, then `e(x)`."""

    def unscaled(at, materials):
        own, e = X[materials], errors[materials]
        m, power = np.exp(np.mean(np.log(e))), len(e) / (len(e) + 2)
        d = min(np.linalg.norm(at - row) for row in own) / length_scale
        around = np.prod((e / m) ** (power * blend_shares(at, own, length_scale)))
        return m * around * (1 + d**2) ** (1 / 8), m, e.max(), d * length_scale

    everything = list(range(len(X)))
    ratios = [errors[i] / unscaled(places[i], [j for j in everything if j != i])[0] for i in everything]
    c = math.exp(max(np.median(np.log(ratios)), np.quantile(np.log(ratios), 0.9) - math.log(2)))
    e, m, most, d = unscaled(x, everything)
    gap = max(min(np.linalg.norm(X[i] - X[j]) for j in everything if j != i) for i in everything)
    return max(c * e, min(m * (d / gap) ** 2, max(most, m)))
