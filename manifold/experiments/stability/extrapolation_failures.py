"""Failure modes of predictions away from the materials: outside of them all, and between materials far apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.directions import from_spherical
from manifold.experiments.stability.bench import ALPHAS, Bench, named, predict
from manifold.experiments.stability.model_failures import HALF_OF_NEAREST, held_out, worst
from manifold.experiments.stability.trials import Found, Mode, Trial
from manifold.metrics import relative_error
from manifold.model.prediction import PredictedBRDF
from manifold.records import Array

HALF_OF_VALUE = 0.5  # f depends on which end is the light by as much: more than measured materials show
WHITE = 1.05  # measured materials reach a little above 1 too
FEW = 0.01  # one value in a hundred
_RAYS = 6
_INCIDENCES_DEG = (10.0, 45.0, 70.0)  # other ones than predictions are judged by
_DISTANCES = (0.0, 0.5, 1.0, 2.0)
_DISTANCE = "length scales outside"

_NEGATIVE, _ALBEDO, _NON_RECIPROCAL = range(3)


def _measure(brdf: PredictedBRDF, bench: Bench) -> Array:
    """Share of negative values, largest albedo, and relative difference of f(wi, wo) and f(wo, wi): (3,)."""
    wi, wo = bench.pairs.wi, bench.pairs.wo
    f, swapped = brdf.eval(wi, wo), brdf.eval(wo, wi)
    albedo = brdf.albedo(from_spherical(np.deg2rad(_INCIDENCES_DEG), 0.0), 24)
    apart = relative_error(f, swapped, bench.pairs.cosines)
    return np.array([np.mean(f < 0), albedo.max(), apart])


Places = Callable[[Bench, float], Iterator[tuple[PredictedBRDF, tuple[str, ...]]]]
"""Predictions at a distance outside the materials, with what was said about each."""


def _on_rays(kind: str, mapping: str = "cube-root") -> Places:
    """On rays from the centre of the materials."""

    def places(bench: Bench, distance: float) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
        model = bench.model(kind, mapping)
        angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
        for ray in np.stack([np.cos(angles), np.sin(angles)], axis=1):
            yield predict(
                model, ray * (float(np.max(model.X @ ray)) + distance * model.space.kernel.length_scale)
            )

    return places


def _brighter(bench: Bench, distance: float) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
    """At materials' own structures, in colours moved up."""
    model = bench.model("monochrome")
    for x, colours in zip(model.X[::3], model.space.colour_table()[0][::3], strict=True):
        yield predict(model, x, colours + distance * model.space.kernel.length_scale)


_OUTSIDE: dict[str, Places] = {
    "material": _on_rays("material"),
    "raw values": _on_rays("material", "identity"),
    "monochrome": _on_rays("monochrome"),
    "brighter": _brighter,
}


def _outside(name: str, index: int) -> Trial:
    """The worst prediction at a distance, by one of three measures; all are measured at once."""

    def trial(bench: Bench, distance: float) -> Found:
        seen = bench.once(
            ("outside", name, distance),
            lambda: [(_measure(brdf, bench), said) for brdf, said in _OUTSIDE[name](bench, distance)],
        )
        return worst(Found(float(measured[index]), said) for measured, said in seen)

    return trial


def _by(index: int) -> dict[str, Trial]:
    return {name: _outside(name, index) for name in _OUTSIDE}


def _across(ratio: float) -> tuple[str, str, float]:
    """Two members of the family, as far apart in roughness as a ratio, and the roughness halfway."""
    rough = ALPHAS[-1]
    smooth = min(ALPHAS, key=lambda alpha: abs(rough / alpha - ratio))
    return named(smooth, 1), named(rough, 1), float(np.sqrt(smooth * rough))


def _on_the_way(walk: Callable[[Bench, str, str, float], BRDF]) -> Trial:
    """The best of nine places on the way from one material to another, beside the plastic halfway."""

    def trial(bench: Bench, ratio: float) -> Found:
        a, b, middle = _across(ratio)
        truth = held_out(bench, middle)
        ends = [MeasuredBRDF(file) for file in bench.family if file.name in (a, b)]
        nearest = min(bench.error(end, truth) for end in ends)
        found = min(bench.error(walk(bench, a, b, float(t)), truth) for t in np.linspace(0.1, 0.9, 9))
        return Found(found / nearest)

    return trial


MODES: tuple[Mode, ...] = (
    Mode(
        "negative_values", "predictions outside the materials", _DISTANCE, _DISTANCES,
        "share of negative values", FEW, _by(_NEGATIVE),
        "Stay between the materials, or let --physical cut the values.",
    ),
    Mode(
        "energy_gain", "predictions outside the materials", _DISTANCE, _DISTANCES,
        "largest albedo", WHITE, _by(_ALBEDO),
        "Stay between the materials, or let --physical scale the prediction down.",
    ),
    Mode(
        "non_reciprocity", "predictions outside the materials", _DISTANCE, _DISTANCES,
        "difference of f(wi, wo) and f(wo, wi), relative", HALF_OF_VALUE, _by(_NON_RECIPROCAL),
        "Stay between the materials; --physical makes a prediction reciprocal.",
    ),
    Mode(
        "across_classes", "walk between a smooth and a rough material", "ratio of roughness",
        (ALPHAS[3] / ALPHAS[2], ALPHAS[3] / ALPHAS[1], ALPHAS[3] / ALPHAS[0]),
        "error beside the plastic halfway, in that of the nearer end", HALF_OF_NEAREST,
        {
            "GP, material": _on_the_way(lambda bench, a, b, t: bench.model("material").interpolate(a, b, t)),
            "GP, monochrome": _on_the_way(lambda bench, a, b, t: bench.model("monochrome").interpolate(a, b, t)),
            "linear": _on_the_way(lambda bench, a, b, t: bench.model("material").blend(a, b, t)),
        },
        "Use `interpolate`; a linear mix of lobes far apart in width shows both of them, not one between.",
    ),
)  # fmt: skip
