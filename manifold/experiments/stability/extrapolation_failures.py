"""Failure modes of predictions away from the materials: outside of them all, and between materials far apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.experiments.stability.limits import BALL, HALF_OF_NEAREST
from manifold.experiments.stability.model_failures import held_out
from manifold.experiments.stability.testbed import ALPHAS, TestBed, named, predict
from manifold.experiments.stability.trials import Limit, Measurement, Mode, Trial
from manifold.model.prediction import PredictedBRDF

_RAYS = 6

Places = Callable[[TestBed, float], Iterator[tuple[PredictedBRDF, tuple[str, ...]]]]
"""Predictions at a distance outside the materials, with their diagnostics."""


def _from_outermost(kind: str, mapping: str = "cube-root") -> Places:
    """From the outermost material in each of several directions further in that direction."""

    def places(bed: TestBed, distance: float) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
        model = bed.model(kind, mapping)
        angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
        for ray in np.stack([np.cos(angles), np.sin(angles)], axis=1):
            outermost = model.X[np.argmax(model.X @ ray)]
            yield predict(model, outermost + distance * model.space.kernel.length_scale * ray)

    return places


def _brighter(bed: TestBed, distance: float) -> Iterator[tuple[PredictedBRDF, tuple[str, ...]]]:
    """At materials' own structures, in colours moved up."""
    model = bed.model("monochrome")
    for x, colours in zip(model.X[::3], model.space.colour_table()[0][::3], strict=True):
        yield predict(model, x, colours + distance * model.space.kernel.length_scale)


def _outside(places: Places) -> Trial:
    """Differences between the balls of predictions and of the nearest plastic, wherever its latent would be."""

    def trial(bed: TestBed, distance: float) -> list[Measurement]:
        return [
            Measurement(bed.ball_difference_to_plastics(brdf), messages)
            for brdf, messages in places(bed, distance)
        ]

    return trial


def _across(ratio: float) -> tuple[str, str, float]:
    """Two members of the family, as far apart in roughness as a ratio, and the roughness halfway."""
    rough = ALPHAS[-1]
    smooth = min(ALPHAS, key=lambda alpha: abs(rough / alpha - ratio))
    return named(smooth, 1), named(rough, 1), float(np.sqrt(smooth * rough))


def _on_the_way(walk: Callable[[TestBed, str, str, float], BRDF]) -> Trial:
    """The best of nine places on the way from one material to another, beside the plastic halfway."""

    def trial(bed: TestBed, ratio: float) -> Measurement:
        a, b, middle = _across(ratio)
        truth = held_out(bed, middle)
        ends = [MeasuredBRDF(file) for file in bed.family if file.name in (a, b)]
        nearest = min(bed.error(end, truth) for end in ends)
        found = min(bed.error(walk(bed, a, b, float(t)), truth) for t in np.linspace(0.1, 0.9, 9))
        return Measurement(found / nearest)

    return trial


MODES: tuple[Mode, ...] = (
    Mode(
        "outside_materials", "predictions outside the materials", "length scales from the outermost material",
        (0.0, 0.25, 0.5, 1.0, 2.0),
        Limit("CIEDE2000 between the balls of the prediction and of the nearest "
        "plastic", BALL.value, BALL.reason),
        {
            "material": _outside(_from_outermost("material")),
            "raw values": _outside(_from_outermost("material", "identity")),
            "monochrome": _outside(_from_outermost("monochrome")),
            "blend": _outside(_from_outermost("blend")),
            "brighter": _outside(_brighter),
        },
        "Stay between the materials, or use --physical, which clips negative values, scales the albedo and makes "
        "f reciprocal.",
    ),
    Mode(
        "across_classes", "path between a smooth and a rough material", "ratio of roughness",
        (ALPHAS[3] / ALPHAS[2], ALPHAS[3] / ALPHAS[1], ALPHAS[3] / ALPHAS[0]),
        HALF_OF_NEAREST,
        {
            "GP, material": _on_the_way(lambda bed, a, b, t: bed.model("material").interpolate(a, b, t)),
            "GP, monochrome": _on_the_way(lambda bed, a, b, t: bed.model("monochrome").interpolate(a, b, t)),
            "blend": _on_the_way(lambda bed, a, b, t: bed.model("blend").interpolate(a, b, t)),
            "linear": _on_the_way(lambda bed, a, b, t: bed.model("material").blend(a, b, t)),
        },
        "Use `interpolate`; a linear mix of a narrow and a wide lobe has both lobes, not one of intermediate "
        "width.",
    ),
)  # fmt: skip
