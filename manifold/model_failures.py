"""Failure modes of manifolds: settings, libraries and latents for which a model's answers are worth little.

Most of them ask for a plastic that lies between the measured ones, and count its error in that of the nearest
measured material.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from manifold import cautions
from manifold.brdf import BRDF, MeasuredBRDF
from manifold.directions import from_spherical
from manifold.model import Manifold
from manifold.records import Array, BsdfFile
from manifold.spaces import CurveSpace
from manifold.stability import Found, Mode, Trial
from manifold.stability_bench import COLOURS, MIDDLE, Bench, embed, predict

KINDS = ("material", "monochrome")
# In errors of the nearest material: a manifold that does not at least halve them is not worth its fit.
HALF_OF_NEAREST = 0.5
_RAYS = 8
_ON_THE_WAY = np.linspace(0.1, 0.9, 9)
_INCIDENCES_DEG = (10.0, 45.0, 70.0)  # other ones than predictions are judged by


def held_out(bench: Bench, alpha: float = MIDDLE) -> MeasuredBRDF:
    """A measured plastic that is not in the family."""
    return MeasuredBRDF(bench.file(alpha, COLOURS[1]))


def in_errors_of_nearest(bench: Bench, found: BRDF, truth: MeasuredBRDF) -> float:
    """Error of a prediction over that of the nearest material of the family."""
    nearest = min(bench.error(MeasuredBRDF(file), truth) for file in bench.family)
    return bench.error(found, truth) / nearest


def worst(found: Iterable[Found]) -> Found:
    """The largest error about which nothing was said; the largest of all where something always was."""
    every = sorted(found, key=lambda one: -one.error)
    silent = [one for one in every if not one.said]
    return (silent or every)[0]


def _held_out_in(bench: Bench, model: Manifold) -> Found:
    """The held-out plastic, embedded in a model."""
    truth = held_out(bench)
    brdf, said = embed(model, truth)
    return Found(in_errors_of_nearest(bench, brdf, truth), said)


def _of_kinds(trial: Callable[[Bench, float, str], Found]) -> dict[str, Trial]:
    """A trial for each kind of manifold."""
    return {kind: lambda bench, severity, kind=kind: trial(bench, severity, kind) for kind in KINDS}


def _fitted(trial: Callable[[Bench, float], Sequence[BsdfFile]]) -> dict[str, Trial]:
    """The held-out plastic in a model of each kind, fitted to the files that a trial makes."""
    return _of_kinds(
        lambda bench, severity, kind: _held_out_in(bench, bench.fit(trial(bench, severity), kind))
    )


# -- the kernel --------------------------------------------------------------------------------------------


def _rescaled(bench: Bench, length_scale: float, kind: str) -> Found:
    """The held-out plastic at its latent, under a length scale that the latents were not fitted for."""
    truth, fitted = held_out(bench), bench.model(kind)
    known = fitted.embed(truth)
    space = replace(fitted.space, length_scale=length_scale)
    settings = replace(fitted.settings, length_scale=length_scale)
    model = Manifold(fitted.library, fitted.names, space, settings, {})
    brdf, said = predict(model, known.latent, known.colours)
    return Found(in_errors_of_nearest(bench, brdf, truth), said)


def _with_noise(bench: Bench, mu: float, kind: str) -> Found:
    return _held_out_in(bench, bench.fit(bench.family, kind, mu=mu))


# -- the library -------------------------------------------------------------------------------------------


def _with_copies(bench: Bench, count: float) -> list[BsdfFile]:
    """The family, and copies of one member."""
    return [*bench.family, *(replace(bench.family[4], name=f"copy_{k}") for k in range(int(count)))]


def _scaled(file: BsdfFile, factor: float, name: str) -> BsdfFile:
    return replace(file, name=name, spectra=(file.spectra * factor).astype(np.float32))


def _with_near_copy(bench: Bench, difference: float) -> list[BsdfFile]:
    return [*bench.family, _scaled(bench.family[4], 1.0 + difference, "near_copy")]


def _with_outlier(bench: Bench, factor: float) -> list[BsdfFile]:
    return [*bench.family, _scaled(bench.family[4], factor, "outlier")]


def _of_few(bench: Bench, count: float, kind: str) -> Found:
    # The roughest first: what is held out comes to lie outside.
    files = bench.family[::-1][: int(count)]
    return _held_out_in(bench, bench.fit(files, kind, latent_dim=min(2, len(files) - 1) or 1))


def _in_dimensions(bench: Bench, count: float, kind: str) -> Found:
    return _held_out_in(bench, bench.fit(bench.family, kind, latent_dim=int(count)))


def _sharper(bench: Bench, ratio: float, kind: str) -> Found:
    """A lobe sharper than any of the library, by a factor of roughness."""
    truth = held_out(bench, 0.1 / ratio)
    brdf, said = embed(bench.model(kind), truth)
    return Found(bench.error(brdf, truth), said)


# -- extrapolation -----------------------------------------------------------------------------------------


def _on_rays(measure: Callable[[BRDF, Bench], float], kind: str, mapping: str = "cube-root") -> Trial:
    """The worst prediction at a distance outside the materials, in length scales, over rays from their centre."""

    def trial(bench: Bench, distance: float) -> Found:
        model = bench.model(kind, mapping=mapping)
        angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
        found = []
        for ray in np.stack([np.cos(angles), np.sin(angles)], axis=1):
            x = ray * (float(np.max(model.X @ ray)) + distance * model.space.length_scale)
            brdf, said = predict(model, x)
            found.append(Found(measure(brdf, bench), said))
        return worst(found)

    return trial


def _brighter(measure: Callable[[BRDF, Bench], float]) -> Trial:
    """The worst prediction with a material's colours moved up, in length scales."""

    def trial(bench: Bench, distance: float) -> Found:
        model = bench.model("monochrome")
        assert isinstance(model.space, CurveSpace)
        found = []
        for x, colours in zip(model.X, model.space.colours, strict=True):
            brdf, said = predict(model, x, colours + distance * model.space.length_scale)
            found.append(Found(measure(brdf, bench), said))
        return worst(found)

    return trial


def _negative_share(brdf: BRDF, bench: Bench) -> float:
    return float(np.mean(brdf.eval(bench.pairs.wi, bench.pairs.wo) < 0))


def _largest_albedo(brdf: BRDF, bench: Bench) -> float:
    wi = from_spherical(np.deg2rad(_INCIDENCES_DEG), 0.0)
    return float(brdf.albedo(wi, 24).max())


def _non_reciprocity(brdf: BRDF, bench: Bench) -> float:
    wi, wo = bench.pairs.wi, bench.pairs.wo
    weight = bench.pairs.cosines[:, None]
    f, swapped = weight * brdf.eval(wi, wo), weight * brdf.eval(wo, wi)
    return float(np.linalg.norm(f - swapped) / np.linalg.norm(f))


def _outside(measure: Callable[[BRDF, Bench], float]) -> dict[str, Trial]:
    return {
        "material": _on_rays(measure, "material"),
        "material, raw values": _on_rays(measure, "material", "identity"),
        "monochrome": _on_rays(measure, "monochrome"),
        "monochrome, brighter": _brighter(measure),
    }


# -- between two materials ---------------------------------------------------------------------------------


def _best_on_the_way(
    bench: Bench, alpha: float, ends: tuple[str, str], between: Callable[[str, str, float], BRDF]
) -> float:
    truth = held_out(bench, alpha)
    return min(bench.error(between(*ends, float(t)), truth) for t in _ON_THE_WAY)


# -- colours -----------------------------------------------------------------------------------------------


def _asked_for(bench: Bench, reflectance: float) -> Found:
    """A grey of a reflectance, asked for of every structure."""
    model = bench.model("monochrome")
    asked = np.full(model.bands.count, reflectance)
    found = []
    for x in model.X[::3]:
        colours, _ = model.colours_of_reflectance(x, asked)
        reached = model.reflectance_of_colours(x, colours)
        missed = float(np.abs(reached - asked).max())
        brdf, said = predict(model, x, colours)
        found.append(Found(missed, said + _missed(missed)))
    return worst(found)


def _missed(missed: float) -> tuple[str, ...]:
    from manifold.plausibility import Plausibility

    return cautions.of_prediction(False, Plausibility(0.0, 0.0, 0.0), missed)


_ERROR = "error of a held-out plastic, in that of the nearest material"
_DISTANCE = "distance outside the materials, in length scales"
_DISTANCES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)

MODES: tuple[Mode, ...] = (
    Mode(
        "short-length-scale", "prediction between materials, latents fitted for l = 1", "length scale l",
        (1.0, 0.3, 0.1, 0.03, 0.01), _ERROR, HALF_OF_NEAREST, _of_kinds(_rescaled),
        "Embed again with --length-scale 1; the latents adapt to the length scale they are fitted with.",
    ),
    Mode(
        "duplicates", "library with copies of one material", "copies", (0, 1, 6), _ERROR, HALF_OF_NEAREST,
        _fitted(_with_copies),
        "Nothing needs doing; copies share a place on the map and take time only.",
    ),
)  # fmt: skip
