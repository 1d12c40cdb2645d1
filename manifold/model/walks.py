"""Walks between two materials: both get an intermediate roughness, and their values are averaged.

Averaging alone would fade one highlight into the other. Therefore the part of each material that a GGX lobe explains
is given the roughness of the step, and the steps are spaced so that they look equally large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from manifold.analytic.free_lobes import cos_theta_d, microfacet_lobe
from manifold.brdf.interface import BRDF
from manifold.brdf.wrapper import WrappedBRDF
from manifold.colour.ball_colours import ball
from manifold.colour.conversion import srgb_to_xyz, to_srgb
from manifold.colour.difference import delta_e_2000_lab, to_lab
from manifold.core.mapping import Identity
from manifold.core.records import Array
from manifold.model.combination import Combination
from manifold.model.decoding import appearance_pairs
from manifold.model.prediction import PredictedBRDF

ROUGHNESSES = np.geomspace(0.9, 0.005, 36)
WALK_NODES = 17  # values of t, between which a walk's share is linear
_STEPS = 33  # points of a walk, the visible steps between which are added up
_FITTED_NM = (450.0, 550.0, 650.0)  # wavelengths of the bands that choose the roughness
_COARSE = 3  # one roughness in this many is tried first
_LOG_RATIO = float(np.log(ROUGHNESSES[1] / ROUGHNESSES[0]))
_SHAPE_KEPT = 4.0  # positions, at which nothing is kept: 1.8 times as rough
_MOST_EXCESS = 3.0  # multiple of the lobe that is part of the highlight: measured peaks are sharper than GGX
_LEAST_STRENGTH = 1e-4
_LEAST_VALUE = 0.02  # 1/sr: differences between values far below it do not count


@dataclass(frozen=True, eq=False)
class Highlight:
    """The GGX lobe with Schlick's Fresnel term that explains most of a material.

    Attributes:
        position: index of its roughness in `ROUGHNESSES`.
        normal, grazing: Fresnel reflectance at normal and grazing incidence, shape (B,).
        base: Lambertian value beside the lobe in 1/sr, shape (B,).
        strength: mean of `normal` over the bands in which the roughness was fitted.
        gain: factor on the lobe when it replaces measured values, shape (B,).
    """

    position: int
    normal: Array
    grazing: Array
    base: Array
    strength: float
    gain: Array

    def fresnel(self, wi: Array, wo: Array) -> Array:
        """Return the Fresnel reflectance at direction pairs, shape (P, B)."""
        schlick = (1.0 - cos_theta_d(wi, wo)) ** 5
        return self.normal + (self.grazing - self.normal) * schlick[:, None]

    def explained(self, f: Array, lobe: Array) -> Array:
        """Return the part of values f (P, B) that the highlight with this lobe (P, B) explains.

        It includes values above the lobe, up to a limit.
        """
        return np.clip(f, 0.0, lobe) + np.clip(f - lobe - self.base, 0.0, _MOST_EXCESS * lobe)

    def shape_kept(self, position: float) -> float:
        """Return the share of the measured shape that a highlight keeps at another roughness.

        The lobe gives the rest.
        """
        return max(1.0 - abs(position - self.position) / _SHAPE_KEPT, 0.0)


def roughness_at(position: float) -> float:
    """Return the roughness alpha at a fractional index into `ROUGHNESSES`, interpolated geometrically."""
    return float(ROUGHNESSES[0] * np.exp(_LOG_RATIO * position))


def fit_highlight(brdf: BRDF) -> Highlight:
    """Fit a lobe over a Lambertian base with the lowest cube-root error at the direction pairs of grid and ball."""
    pairs = appearance_pairs(brdf.is_isotropic)
    f = np.maximum(brdf.eval(pairs.wi, pairs.wo), 0.0)
    weight = np.cbrt(pairs.cosines)
    schlick = (1.0 - cos_theta_d(pairs.wi, pairs.wo)) ** 5

    def solved(position: int, bands: Sequence[int]) -> tuple[Array, float]:
        """Return albedo of the base, normal and grazing reflectance, shape (3, bands), and the squared error."""
        lobe = microfacet_lobe(pairs.wi, pairs.wo, roughness_at(position))
        columns = np.stack([np.full_like(lobe, 1.0 / np.pi), lobe * (1.0 - schlick), lobe * schlick], axis=1)
        found, error = [], 0.0
        for band in bands:
            # Slope of cube roots, up to a factor.
            slope = weight * (f[:, band] + _LEAST_VALUE) ** (-2.0 / 3.0)
            q, r = np.linalg.qr(columns * slope[:, None])
            found.append(
                scipy.optimize.lsq_linear(r, q.T @ (f[:, band] * slope), (0.0, 1.0), method="bvls").x
            )
            error += float(np.sum((weight * (np.cbrt(columns @ found[-1]) - np.cbrt(f[:, band]))) ** 2))
        return np.transpose(found), error

    nm = brdf.bands.wavelengths_nm
    some = [0, 1, 2] if nm is None else [int(np.argmin(np.abs(np.array(nm) - at))) for at in _FITTED_NM]
    last = len(ROUGHNESSES) - 1
    best = min(range(0, last + 1, _COARSE), key=lambda k: solved(k, some)[1])
    near = range(max(best - _COARSE + 1, 0), min(best + _COARSE, last + 1))
    best = min(near, key=lambda k: solved(k, some)[1])
    (albedo, normal, grazing), _ = solved(best, range(brdf.bands.count))
    return Highlight(
        best,
        normal,
        grazing,
        albedo / np.pi,
        max(float(normal[some].mean()), _LEAST_STRENGTH),
        np.ones(len(normal)),
    )


def positions_between(start: Highlight, end: Highlight, share: Array) -> Array:
    """Return the roughness positions at shares (n,) of a walk, for which the peak F / alpha^2 changes evenly.

    The peak is interpolated geometrically. If the roughness were interpolated, the highlight between a strong, rough
    one and a weak, sharp one would be brighter than both.
    """
    mean = (1.0 - share) * start.strength + share * end.strength
    rise = np.log(mean) - (1.0 - share) * np.log(start.strength) - share * np.log(end.strength)
    found = (1.0 - share) * start.position + share * end.position + 0.5 * rise / _LOG_RATIO
    low, high = sorted((start.position, end.position))
    return np.clip(found, low, high)


class RoughenedBRDF(WrappedBRDF):
    """A material whose highlight has another roughness; values that the lobe does not explain are kept.

    Its value is `f - m + L' (k m / L + (1 - k) g F)`, where L is the lobe of the material, L' the lobe of the other
    roughness, F the Fresnel term, m the part of f that L F explains, g the gain, and k the share of the measured
    shape that is kept. At the material's own roughness k is 1 and the value is f. It is never negative where f is
    not.
    """

    def __init__(self, brdf: BRDF, highlight: Highlight, position: float) -> None:
        """Change the roughness of a BRDF to that at a position between `ROUGHNESSES`."""
        super().__init__(brdf)
        self._highlight, self._position = highlight, position
        self.name: str = getattr(brdf, "name", type(brdf).__name__)

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., B); arguments and errors as in the wrapped BRDF."""
        f = self._brdf.eval(wi, wo)
        wi, wo = (np.broadcast_to(w, (*f.shape[:-1], 3)).reshape(-1, 3) for w in (wi, wo))
        flat, fresnel = f.reshape(-1, f.shape[-1]), self._highlight.fresnel(wi, wo)
        own, other = (lobe_at(wi, wo, at) for at in (self._highlight.position, self._position))
        moved = self._highlight.explained(flat, own * fresnel)
        kept = self._highlight.shape_kept(self._position)
        return (
            flat - moved + other * (kept * moved / own + (1.0 - kept) * self._highlight.gain * fresnel)
        ).reshape(f.shape)


def lobe_at(wi: Array, wo: Array, position: float) -> Array:
    """Return the GGX lobe of a perfect reflector in 1/sr, shape (P, 1); it is 0 below the horizon."""
    lobe = microfacet_lobe(wi, wo, roughness_at(position))
    is_above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
    return np.where(is_above, lobe, np.finfo(float).tiny)[:, None]


@dataclass(frozen=True, eq=False)
class Walked:
    """A material as the end of a walk, with the pixels of its ball at R roughnesses in linear sRGB, (R, K, 3)."""

    highlight: Highlight
    balls: Array

    @classmethod
    def of(cls, brdf: BRDF) -> Walked:
        """Fit the highlight of a material, and render its ball at every roughness."""
        highlight, lit = fit_highlight(brdf), ball()
        f, fresnel = brdf.eval(lit.wi, lit.wo), highlight.fresnel(lit.wi, lit.wo)
        own = lobe_at(lit.wi, lit.wo, highlight.position)
        moved = highlight.explained(f, own * fresnel)
        # The lobe sends as much light to the viewer as what it stands for.
        gain = lit.light @ moved / np.maximum(lit.light @ (own * fresnel), np.finfo(float).tiny)
        highlight = replace(highlight, gain=gain)
        rest, shaped, smooth = (
            to_srgb(part, brdf.bands) for part in (f - moved, moved / own, gain * fresnel)
        )
        balls = []
        for k in range(len(ROUGHNESSES)):
            kept = highlight.shape_kept(k)
            lobe = lobe_at(lit.wi, lit.wo, k)
            balls.append(lit.of(rest + lobe * (kept * shaped + (1.0 - kept) * smooth)))
        return cls(highlight, np.stack(balls))

    def ball_at(self, positions: Array) -> Array:
        """Return the linear sRGB pixels (n, K, 3) of the ball at fractional indices (n,) into `ROUGHNESSES`."""
        below = np.minimum(positions.astype(int), len(ROUGHNESSES) - 2)
        part = (positions - below)[:, None, None]
        return np.asarray((1.0 - part) * self.balls[below] + part * self.balls[below + 1])


def walk_shares(start: Walked, end: Walked) -> Array:
    """Return the end material's shares at `WALK_NODES` equally spaced t, for which steps have equal CIEDE2000."""
    u = np.linspace(0.0, 1.0, _STEPS)
    positions = positions_between(start.highlight, end.highlight, u)
    share = u[:, None, None]
    linear = (1.0 - share) * start.ball_at(positions) + share * end.ball_at(positions)
    lab = to_lab(srgb_to_xyz(np.clip(linear, 0.0, 1.0)), srgb_to_xyz(np.ones(3)))
    sizes = delta_e_2000_lab(lab[:-1], lab[1:]).mean(axis=1)
    length = np.concatenate([[0.0], np.cumsum(sizes + np.finfo(float).eps)])
    return np.interp(np.linspace(0.0, length[-1], WALK_NODES), length, u)


def step_of(ends: Sequence[BRDF], walked: Sequence[Walked], share: float) -> PredictedBRDF:
    """Return the material of a walk at which the second end has this share."""
    start, end = (w.highlight for w in walked)
    position = float(positions_between(start, end, np.array([share]))[0])
    parts = [RoughenedBRDF(brdf, w.highlight, position) for brdf, w in zip(ends, walked, strict=True)]
    return PredictedBRDF(parts, Combination(Identity(), np.array([1.0 - share, share])))


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk between two materials with the same bands."""

    ends: tuple[BRDF, BRDF]
    walked: tuple[Walked, Walked]

    @classmethod
    def between(cls, start: BRDF, end: BRDF) -> Walk:
        """Prepare the walk between two BRDFs by fitting their highlights."""
        return cls((start, end), (Walked.of(start), Walked.of(end)))

    @cached_property
    def shares(self) -> Array:
        """Return the share of the second material at `WALK_NODES` equally spaced values of t."""
        return walk_shares(*self.walked)

    def at(self, t: float) -> PredictedBRDF:
        """Return the BRDF at t, from 0 to 1; at both ends it is the material itself."""
        if t in (0.0, 1.0):
            return PredictedBRDF([self.ends[int(t)]], Combination(Identity(), np.ones(1)))
        share = float(np.interp(t, np.linspace(0.0, 1.0, WALK_NODES), self.shares))
        return step_of(self.ends, self.walked, share)
