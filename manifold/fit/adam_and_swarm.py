"""Two earlier fitting methods, for comparison: two-stage Adam, and a particle swarm.

Source: the measured-material pipeline of a game studio, and its predecessor of 2015 for a hand-held instrument of 20
geometries. Where it gives no numbers (learning rate, penalty, window of the convergence test), those here are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from manifold.colour.conversion import to_xyz
from manifold.colour.difference import to_lab
from manifold.directions import to_rusinkiewicz
from manifold.errors import RendererError
from manifold.fit.fit_samples import FitSamples
from manifold.fit.gauss_newton import Minimum, Residuals
from manifold.pairs import RusinkiewiczGrid
from manifold.records import Array
from manifold.render import backend
from manifold.render.bsdf_evaluation import bsdf_keys, evaluator, load_bsdf
from manifold.render.bsdf_parameters import BsdfFamily, FreeParameter


@dataclass(frozen=True)
class AdamOptions:
    """Hyperparameters of two-stage Adam.

    Attributes:
        learning_rate: of both stages.
        max_epochs: of each stage.
        penalty: weight of the squared distance of the parameters from their defaults.
        window, threshold: a stage ends when the mean loss of a window of epochs is no more than this share below that
            of the window before.
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
        inertia, attraction: of a particle's velocity, and towards its own and the swarm's best place.
    """

    particles: int = 40
    iterations: int = 200
    inertia: float = 0.729
    attraction: float = 1.494
    seed: int = 0


def adam(family: BsdfFamily, samples: FitSamples, residuals: Residuals, options: AdamOptions) -> Minimum:
    """Fit by Adam in two stages: luminance of RGB samples for the shared values, then everything.

    The second stage minimises the squared linear error. The cost of the result is that of the residuals,
    which Adam does not use.

    Parameters are clamped to their ranges, colours, which come last, to [0, 1], after every step.
    """
    mi, dr = backend.mitsuba(colour="rgb"), backend.drjit()
    if not mi.variant().startswith("llvm"):
        raise RendererError(
            f"method adam needs Mitsuba's LLVM backend, found {mi.variant()}; use gauss-newton"
        )
    keys = bsdf_keys(mi, family)
    shared = [o for o in family.parameters if not o.per_band]
    colours = [o for o in family.parameters if o.per_band]
    values = {o.name: o.default for o in shared} | {o.name: [1.0] * 3 for o in colours}
    bsdf = load_bsdf(family, values)
    scene = mi.traverse(bsdf)
    si = dr.zeros(mi.SurfaceInteraction3f, len(samples))
    si.wi, wo = mi.Vector3f(samples.wi.T.astype(np.float32)), mi.Vector3f(samples.wo.T.astype(np.float32))
    target = mi.Color3f(samples.f_cos.T.astype(np.float32))
    weight = mi.Float(samples.weight.astype(np.float32))

    def loss(luminance_only: bool) -> Any:
        difference = bsdf.eval(mi.BSDFContext(), si, wo, True) - target
        if luminance_only:
            return dr.mean(weight * dr.square(mi.luminance(difference)))
        return dr.mean(weight * dr.mean(dr.square(difference)))

    converged = not shared or _stage(mi, dr, scene, keys, shared, lambda: loss(True), options)
    for o in colours:
        scene[keys[o.name]] = mi.Color3f(0.5)
    scene.update()
    converged &= _stage(mi, dr, scene, keys, shared + colours, lambda: loss(False), options)
    found = {o.name: np.array(scene[keys[o.name]], float).ravel() for o in family.parameters}
    p = residuals.layout.join(found)
    return Minimum(p, _cost(residuals, p), converged)


def _stage(
    mi: Any, dr: Any, scene: Any, keys: dict[str, str], free: list[FreeParameter], loss: Any, options: AdamOptions
) -> bool:  # fmt: skip
    """Run Adam until the loss is constant or the epochs are over; return whether it became constant."""
    optimizer = mi.ad.Adam(lr=options.learning_rate)
    for o in free:
        optimizer[keys[o.name]] = scene[keys[o.name]]
    scene.update(optimizer)
    history: list[float] = []
    for _ in range(options.max_epochs):
        error = loss()
        total = error
        for o in free:
            total += options.penalty * dr.mean(dr.square(optimizer[keys[o.name]] - o.default))
        dr.backward(total)
        optimizer.step()
        for o in free:
            low, high = (max(o.minimum, 0.0), min(o.maximum, 1.0)) if o.per_band else (o.minimum, o.maximum)
            optimizer[keys[o.name]] = dr.clip(dr.detach(optimizer[keys[o.name]]), low, high)
        scene.update(optimizer)
        history.append(float(np.array(error).item()))
        n = options.window
        if len(history) >= 2 * n and len(history) % n == 0:
            before, now = np.mean(history[-2 * n : -n]), np.mean(history[-n:])
            if before - now <= options.threshold * before:
                return True
    return False


def swarm(family: BsdfFamily, samples: FitSamples, residuals: Residuals, options: SwarmOptions) -> Minimum:
    """Fit by particles that minimise the colour difference of RGB samples on a virtual hemisphere.

    The hemisphere's values are looked-up measurements. The cost of the result is that of the residuals.

    Every virtual direction pair takes the value of the sample nearest in Rusinkiewicz's angles; differences are
    CIELAB's of 1976.
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
    low = np.where(layout.is_per_band, np.maximum(layout.minimum, 0.0), layout.minimum)
    high = np.where(layout.is_per_band, np.minimum(layout.maximum, 1.0), layout.maximum)
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
