"""Two earlier fitting methods, for comparison: two-stage Adam, and a particle swarm.

Source: the measured-material pipeline of a game studio, and its predecessor of 2015 for a hand-held instrument of 20
geometries. They state no learning rate, penalty or window of the convergence test; the defaults here are our own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from manifold.analytic.principled import LUMINANCE
from manifold.colour.conversion import to_xyz
from manifold.colour.difference import to_lab
from manifold.core.directions import to_rusinkiewicz
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, Mask
from manifold.fit.fit_samples import FitSamples
from manifold.fit.gauss_newton import Minimum, Residuals
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import BsdfFamily, ParameterLayout


@dataclass(frozen=True)
class AdamOptions:
    """Hyperparameters of two-stage Adam.

    Attributes:
        learning_rate: learning rate of both stages.
        max_epochs: largest number of epochs of each stage.
        penalty: weight of the squared distance of the parameters from their defaults.
        window, threshold: a stage ends when the mean loss over a window of epochs falls by less than the share
            `threshold` from one window to the next.
    """

    learning_rate: float = 0.01
    max_epochs: int = 2000
    penalty: float = 1e-4
    window: int = 20
    threshold: float = 1e-4


@dataclass(frozen=True)
class SwarmOptions:
    """Hyperparameters of the particle swarm.

    Attributes:
        inertia, attraction: inertia of a particle's velocity, and attraction to its own and to the swarm's best
            place.
    """

    particles: int = 40
    iterations: int = 200
    inertia: float = 0.729
    attraction: float = 1.494
    seed: int = 0


def adam(family: BsdfFamily, samples: FitSamples, residuals: Residuals, options: AdamOptions) -> Minimum:
    """Fit by Adam in two stages: first the shared values to the luminance of RGB samples, then all values.

    The second stage minimises the squared linear error. The reported cost is that of the residuals, not Adam's loss.

    Parameters are clamped to their ranges, colours to [0, 1] within them, after every step.
    """
    at_samples = evaluator(family, samples.wi, samples.wo, 3)
    layout, weight = at_samples.layout, samples.weight[:, None] / len(samples)

    def luminance(p: Array) -> tuple[float, Array]:
        value, J = at_samples.jacobian(p)
        difference = (value - samples.f_cos) @ LUMINANCE
        weighted = weight[:, 0] * difference
        return float(weighted @ difference), 2.0 * np.einsum("m,mbk,b->k", weighted, J, LUMINANCE)

    def everything(p: Array) -> tuple[float, Array]:
        value, J = at_samples.jacobian(p)
        difference = value - samples.f_cos
        weighted = weight * difference / 3.0
        return float(np.sum(weighted * difference)), 2.0 * np.einsum("mb,mbk->k", weighted, J)

    p = np.where(layout.is_per_band, 1.0, layout.default)
    is_shared = ~layout.is_per_band
    converged = True
    if np.any(is_shared):
        p, converged = _stage(layout, p, is_shared, luminance, options)
    p[layout.is_per_band] = 0.5
    p, has_ended = _stage(layout, p, np.ones(layout.size, bool), everything, options)
    return Minimum(p, _cost(residuals, p), converged and has_ended)


def _stage(
    layout: ParameterLayout,
    p: Array,
    free: Mask,
    loss: Callable[[Array], tuple[float, Array]],
    options: AdamOptions,
) -> tuple[Array, bool]:
    """Run Adam until the loss is constant or the epochs are over; return values (K,), and whether it was constant."""
    p = p.copy()
    low, high = _bounds(layout)
    penalty = 2.0 * options.penalty / np.where(layout.is_per_band, layout.n_bands, 1)
    mean, square = np.zeros(layout.size), np.zeros(layout.size)
    history: list[float] = []
    for epoch in range(1, options.max_epochs + 1):
        error, slope = loss(p)
        slope = np.where(free & np.isfinite(slope), slope + penalty * (p - layout.default), 0.0)
        mean, square = 0.9 * mean + 0.1 * slope, 0.999 * square + 0.001 * slope**2
        step = mean / (1.0 - 0.9**epoch) / (np.sqrt(square / (1.0 - 0.999**epoch)) + 1e-8)
        p[free] = np.clip(p - options.learning_rate * step, low, high)[free]
        history.append(error)
        n = options.window
        if len(history) >= 2 * n and len(history) % n == 0:
            before, now = np.mean(history[-2 * n : -n]), np.mean(history[-n:])
            if before - now <= options.threshold * before:
                return p, True
    return p, False


def _bounds(layout: ParameterLayout) -> tuple[Array, Array]:
    """Return the lower and upper ends of the ranges, each (K,); ranges of colours are limited to [0, 1]."""
    low = np.where(layout.is_per_band, np.maximum(layout.minimum, 0.0), layout.minimum)
    return low, np.where(layout.is_per_band, np.minimum(layout.maximum, 1.0), layout.maximum)


def swarm(family: BsdfFamily, samples: FitSamples, residuals: Residuals, options: SwarmOptions) -> Minimum:
    """Fit by particles that minimise the colour difference of RGB samples on a virtual hemisphere.

    Every direction pair of the hemisphere has the value of the sample nearest in Rusinkiewicz's angles. Differences
    are CIELAB 1976. The cost of the result is computed from the residuals.
    """
    wi, wo, above = RusinkiewiczGrid(10, 8, 6).directions()
    keep = above & (np.minimum(wi[:, 2], wo[:, 2]) > 0.1)
    wi, wo = wi[keep], wo[keep]
    tree = cKDTree(_angles(samples.wi, samples.wo))
    looked_up = samples.f[tree.query(_angles(wi, wo))[1]]
    virtual = evaluator(family, wi, wo, 3)
    target = _lab(np.pi * looked_up, samples)

    def cost(p: Array) -> Array:
        f = virtual.values(p) / wo[:, 2:]
        return np.asarray(np.mean(np.sum((_lab(np.pi * f, samples) - target) ** 2, axis=-1), axis=-1))

    layout, rng = residuals.layout, np.random.default_rng(options.seed)
    low, high = _bounds(layout)
    shape = (options.particles, layout.size)
    place = rng.uniform(low, high, shape)
    velocity = rng.uniform(-1, 1, shape) * (high - low) * 0.1
    own, own_cost = place.copy(), cost(place)
    for _ in range(options.iterations):
        leader = own[np.argmin(own_cost)]
        pull = options.attraction * rng.random((2, *shape))
        velocity = options.inertia * velocity + pull[0] * (own - place) + pull[1] * (leader - place)
        place = np.clip(place + velocity, low, high)
        now = cost(place)
        better = now < own_cost
        own[better], own_cost[better] = place[better], now[better]
    p = own[np.argmin(own_cost)]
    return Minimum(p, _cost(residuals, p), True)


def _cost(residuals: Residuals, p: Array) -> float:
    return float(np.sum(residuals.value(residuals.layout.inward(p)) ** 2))


def _angles(wi: Array, wo: Array) -> Array:
    """Return half and difference angles as points whose distances can be compared, shape (M, 4)."""
    theta_h, theta_d, phi_d, _ = to_rusinkiewicz(wi, wo)
    # Reciprocity makes phi_d and phi_d + pi the same: double angles; it means nothing where theta_d is 0.
    return np.stack(
        [theta_h, theta_d, np.sin(theta_d) * np.cos(2 * phi_d), np.sin(theta_d) * np.sin(2 * phi_d)], axis=-1
    )


def _lab(reflectance: Array, samples: FitSamples) -> Array:
    """Return CIELAB (..., 3) of linear sRGB reflectance; white is the perfect diffuser."""
    return to_lab(to_xyz(reflectance, samples.bands), to_xyz(np.ones(3), samples.bands))
