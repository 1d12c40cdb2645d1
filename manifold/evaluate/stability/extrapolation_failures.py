"""Failure modes of predictions away from the materials: outside of them all, and between materials far apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.evaluate.stability.model_failures import held_out
from manifold.evaluate.stability.testbed import ALPHAS, TestBed, named, predict
from manifold.evaluate.stability.trials import BALL, HALF_OF_NEAREST, Limit, Measurement, Mode
from manifold.model.prediction import PredictedBRDF

_RAYS = 6

Places = Callable[[TestBed, float], Iterator[tuple[PredictedBRDF, tuple[str, ...]]]]
"""Predictions at a distance outside the materials, with their diagnostics."""


def _from_outermost(
    kind: str, mapping: str, bed: TestBed, distance: float
) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
    """From the outermost material in each of several directions further in that direction."""
    model = bed.model(kind, mapping)
    angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
    for ray in np.stack([np.cos(angles), np.sin(angles)], axis=1):
        outermost = model.X[np.argmax(model.X @ ray)]
        yield predict(model, outermost + distance * model.space.kernel.length_scale * ray)


def _brighter(bed: TestBed, distance: float) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
    """At materials' own structures, in colours moved up."""
    model = bed.model("blend")
    for x, colours in zip(model.X[::3], model.space.own_colours[::3], strict=True):
        yield predict(model, x, colours + distance * model.space.kernel.length_scale)


def _outside(places: Places, bed: TestBed, distance: float) -> list[Measurement]:
    """Differences between the balls of predictions and of the nearest plastic, wherever its latent would be."""
    return [
        Measurement(bed.ball_difference_to_plastics(brdf), messages)
        for brdf, messages in places(bed, distance)
    ]


def _across(ratio: float) -> tuple[str, str, float]:
    """Two members of the family, as far apart in roughness as a ratio, and the roughness halfway."""
    rough = ALPHAS[-1]
    smooth = min(ALPHAS, key=lambda alpha: abs(rough / alpha - ratio))
    return named(smooth, 1), named(rough, 1), float(np.sqrt(smooth * rough))


def _on_the_path(kind: str, bed: TestBed, a: str, b: str, t: float) -> BRDF:
    """What lies between two materials on a map."""
    model = bed.model(kind)
    return model.predict(model.between(a, b, t))


def _on_the_walk(bed: TestBed, a: str, b: str, t: float) -> BRDF:
    return bed.model("blend").interpolate(a, b, t)


def _on_the_way(walk: Callable[[TestBed, str, str, float], BRDF], bed: TestBed, ratio: float) -> Measurement:
    """The best of nine places on the way from one material to another, beside the plastic halfway."""
    a, b, middle = _across(ratio)
    truth = held_out(bed, middle)
    ends = [MeasuredBRDF(file) for file in bed.family if file.name in (a, b)]
    nearest = min(bed.error(end, truth) for end in ends)
    found = min(bed.error(walk(bed, a, b, float(t)), truth) for t in np.linspace(0.1, 0.9, 9))
    return Measurement(found / nearest)


MODES: tuple[Mode, ...] = (
    Mode(
        "outside_materials", "predictions outside the materials", "length scales from the outermost material",
        (0.0, 0.25, 0.5, 1.0, 2.0),
        Limit("CIEDE2000 between the balls of the prediction and of the nearest "
        "plastic", BALL.value, BALL.reason),
        {
            "material": partial(_outside, partial(_from_outermost, "material", "cube-root")),
            "raw values": partial(_outside, partial(_from_outermost, "material", "identity")),
            "blend": partial(_outside, partial(_from_outermost, "blend", "cube-root")),
            "brighter": partial(_outside, _brighter),
        },
        "Stay between the materials, or write a physical file: negative values are clipped, the albedo is scaled, "
        "and f made reciprocal.",
    ),
    Mode(
        "across_classes", "path between a smooth and a rough material", "ratio of roughness",
        (ALPHAS[3] / ALPHAS[2], ALPHAS[3] / ALPHAS[1], ALPHAS[3] / ALPHAS[0]),
        HALF_OF_NEAREST,
        {
            "GP, material": partial(_on_the_way, partial(_on_the_path, "material")),
            "blend": partial(_on_the_way, partial(_on_the_path, "blend")),
            "walk": partial(_on_the_way, _on_the_walk),
        },
        "Use `interpolate`: a straight path of latents may pass other materials, and an average of a narrow and a "
        "wide lobe has both lobes, not one of intermediate width.",
        ("blend",),
    ),
)  # fmt: skip
