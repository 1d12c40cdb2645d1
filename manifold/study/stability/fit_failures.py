"""Failure modes of fits: local minima, too few directions, lobes and colours that no parameter reaches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import RoughConductor
from manifold.brdf.interface import BRDF
from manifold.brdf.plausibility import mirrored_quadrature
from manifold.colour.conversion import to_srgb
from manifold.core.directions import from_spherical
from manifold.core.metrics import relative_error
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, Bands
from manifold.fit.fit_samples import FitSamples, from_brdf
from manifold.fit.identifiability import DETERMINED
from manifold.fit.principled import FitResult, fit_bsdf
from manifold.registries import FITTERS
from manifold.render.bsdf_evaluation import evaluator
from manifold.render.bsdf_parameters import PRINCIPLED_DEFAULT, BsdfFamily, principled
from manifold.study.stability.testbed import TestBed
from manifold.study.stability.trials import Limit, Measurement, Mode

Pairs = tuple[Array, Array]

_RGB = Bands(None)
_STEEP = 0.05  # cosine of directions that count
_AS_MEASURED = Limit(
    "relative error of the fitted BSDF over all directions",
    0.1,
    "for half of the measured materials, the best fit has a larger error",
)
_HALF_OF_VALUES = Limit(
    "relative error of the values, not of their cube roots",
    0.5,
    "the error is half of the signal",
)

_TRUTH: dict[str, Any] = {
    "base_color": [0.4, 0.3, 0.2], "metallic": 0.3, "roughness": 0.25, "specular": 0.8, "clearcoat": 0.6,
    "clearcoat_gloss": 0.9, "sheen": 0.5,
}  # fmt: skip
_PLAIN = {"metallic": 0.0, "specular": 0.5, "clearcoat": 0.0, "clearcoat_gloss": 1.0, "sheen": 0.0}
_ROUGH_BLACK = _PLAIN | {"base_color": [0.01] * 3, "roughness": 0.95}
_SMOOTH_GREY = _PLAIN | {"base_color": [0.02] * 3, "roughness": 0.1}

# A hand-held instrument of 2015: theta and phi of ten sensors in degrees, for incidences of 15 and 45 degrees.
_SENSORS_DEG = (
    (60, 0), (30, 0), (0, 0), (30, 180), (65, 180), (45, 60), (45, 120), (30, 90), (60, 60), (60, 120),
)  # fmt: skip


def _pairs(grid: RusinkiewiczGrid) -> Pairs:
    """Return direction pairs over the whole hemisphere, denser around the mirror direction."""
    wi, wo, above = grid.directions()
    keep = above & (np.minimum(wi[:, 2], wo[:, 2]) > _STEEP)
    return wi[keep], wo[keep]


_DENSE, _DENSER = _pairs(RusinkiewiczGrid(16, 10, 8)), _pairs(RusinkiewiczGrid(24, 15, 10))


def _old_instrument() -> Pairs:
    wi = [from_spherical(np.deg2rad(t), np.pi) for t in (15, 45) for _ in _SENSORS_DEG]
    wo = [from_spherical(*np.deg2rad(sensor)) for _ in (15, 45) for sensor in _SENSORS_DEG]
    return np.array(wi), np.array(wo)


def _values(family: BsdfFamily, values: Mapping[str, Any], pairs: Pairs, n_bands: int = 3) -> Array:
    """Return f_cos (M, B) of a BSDF."""
    whole = evaluator(family, *pairs, n_bands)
    return whole.values(whole.layout.join(values))[0]


def _samples(values: Mapping[str, Any], pairs: Pairs, noise: float = 0.0, floor: float = 0.0) -> FitSamples:
    """Return values of a Principled BSDF with Gaussian noise: a fraction of the value plus a floor in 1/sr."""
    f = _values(principled(values), values, pairs) / pairs[1][:, 2:]
    f = np.maximum(f + (noise * f + floor) * np.random.default_rng(3).standard_normal(f.shape), 0.0)
    return FitSamples.from_arrays(*pairs, f)


def _error(found: FitResult, values: Mapping[str, Any]) -> float:
    """Return the relative error of a fitted BSDF over all directions."""
    truth = _values(principled(values), values, _DENSE)
    return relative_error(truth, _values(found.family, found.values, _DENSE), np.sqrt(_DENSE[0][:, 2]))


def _messages(found: FitResult, *kinds: str) -> tuple[str, ...]:
    """Return the notes of a fit that are of given kinds, its undetermined values, and whether it failed to converge."""
    notes = [note for note in found.notes if any(kind in note for kind in kinds)]
    notes += ["not converged"] * (not found.minima[0].converged)
    return (*notes, *(f"{s.name}: {s}" for s in found.statements if s.state != DETERMINED))


def _minima(method: str, bed: TestBed, n_free: float) -> Measurement:
    names = PRINCIPLED_DEFAULT[: int(n_free)]
    truth = {name: _TRUTH[name] for name in names}
    found = fit_bsdf(_samples(truth, _DENSE), principled(names), method=method)
    return Measurement(_error(found, truth), _messages(found, "ambiguous", "diffuse", "not a minimum"))


def _roughness(method: str, truth: Mapping[str, Any], bed: TestBed, n_pairs: float) -> Measurement:
    """Measure the error of the roughness that is fitted to few or to many directions."""
    pairs = next(p for p in (_old_instrument(), _DENSE, _DENSER) if len(p[0]) == n_pairs)
    found = fit_bsdf(_samples(truth, pairs, 0.05, 0.003), method=method, noise=0.05)
    error = float(np.abs(np.asarray(found.values["roughness"]) - truth["roughness"]))
    undetermined = [s for s in found.statements if s.name == "roughness" and s.state != DETERMINED]
    notes = [note for note in found.notes if "ambiguous" in note]
    return Measurement(error, (*notes, *(f"{s.name}: {s}" for s in undetermined)))


def _few(bed: TestBed, n_pairs: float) -> Measurement:
    rows = np.random.default_rng(5).permutation(len(_DENSE[0]))[: int(n_pairs)]
    return _fit_to(_DENSE[0][rows], _DENSE[1][rows])


def _incidences(bed: TestBed, count: float) -> Measurement:
    """Measure a fit to all directions around the mirror directions of a few incidences.

    A single incidence is at 45 degrees.
    """
    wi, wo = [], []
    for degrees in np.linspace(10.0, 80.0, int(count)) if count > 1 else [45.0]:
        incident = from_spherical(np.deg2rad(degrees), 0.0)
        outgoing, _ = mirrored_quadrature(incident, 64, 16)
        wo.append(outgoing[outgoing[:, 2] > _STEEP])
        wi.append(np.broadcast_to(incident, wo[-1].shape))
    return _fit_to(np.concatenate(wi), np.concatenate(wo))


def _fit_to(wi: Array, wo: Array) -> Measurement:
    """Measure a fit to some direction pairs by its error at all pairs."""
    found = fit_bsdf(_samples(_TRUTH, (wi, wo)))
    return Measurement(_error(found, _TRUTH), _messages(found, "ambiguous", "not determined"))


def _unreached(brdf: Callable[[float], BRDF], bed: TestBed, severity: float) -> Measurement:
    """Measure the residual of a fit of a material that its parameters cannot represent."""
    found = fit_bsdf(replace(from_brdf(brdf(severity)), is_isotropic=True))  # the default for other sources
    ends = [s.name for s in found.statements if s.at_bound and s.name.startswith(("roughness", "base_color"))]
    kinds = ("diffuse", "does not fit", *(["end of the range"] * bool(ends)))
    notes = [note for note in found.notes if any(kind in note for kind in kinds)]
    return Measurement(found.residuals["linear"], tuple(notes))


def _metal(alpha_x: float, alpha_y: float) -> BRDF:
    return RoughConductor(GGX.anisotropic(alpha_x, alpha_y), np.array(1.2), np.array(5.0), _RGB)


def _mirror(alpha: float) -> BRDF:
    return _metal(alpha, alpha)


def brushed(ratio: float) -> BRDF:
    """Return a brushed metal with roughness 0.05 across the brushing and `ratio` * 0.05 along it."""
    return _metal(0.05 * ratio, 0.05)


def _colour(method: str, bed: TestBed, width: float) -> Measurement:
    """Measure the error of the colour that is fitted to a narrow band of reflectance around 530 nm."""
    nm = np.linspace(400.0, 700.0, 31)
    bands = Bands(tuple(nm))
    green = 0.02 + 0.9 * np.exp(-(((nm - 530.0) / width) ** 2))
    values = {"base_color": green, "roughness": 0.6}
    family = principled(values, wide_colours=True)
    f = _values(family, values, _DENSE, 31) / _DENSE[1][:, 2:]
    found = fit_bsdf(FitSamples.from_arrays(*_DENSE, f, bands=bands), family, method=method)
    error = np.abs(np.array(found.values["base_color"]) - to_srgb(green, bands)).max()
    return Measurement(float(error), _messages(found, "Rec. 709", "not a minimum"))


MODES: tuple[Mode, ...] = (
    Mode(
        "local_minima", "fits of samples that the BSDF can represent exactly", "free parameters",
        (1.0, 3.0, 7.0), _AS_MEASURED, {method: partial(_minima, method) for method in FITTERS},
        "Use gauss-newton, which starts from several points and lists every minimum found.",
    ),
    Mode(
        "rough_or_smooth",
        "rough black and smooth grey, with noise, in the directions of an old instrument",
        "direction pairs", tuple(float(len(pairs[0])) for pairs in (_DENSER, _DENSE, _old_instrument())),
        Limit("error of the roughness", 0.1, "the difference between the highlights of satin and matt paint"),
        {
            "gauss-newton, rough black": partial(_roughness, "gauss-newton", _ROUGH_BLACK),
            "gauss-newton, smooth grey": partial(_roughness, "gauss-newton", _SMOOTH_GREY),
            "swarm, rough black": partial(_roughness, "swarm", _ROUGH_BLACK),
        },
        "Measure near the mirror direction and at grazing angles; otherwise choose among the listed solutions.",
    ),
    Mode(
        "few_directions", "fits to few direction pairs, spread over the hemisphere", "direction pairs",
        (400.0, 10.0, 1.0), _AS_MEASURED, {"gauss-newton": _few},
        "Check the identifiability of each parameter; fix those that the data do not determine.",
    ),
    Mode(
        "few_incidences", "fits to many outgoing directions at few incidences", "incidences",
        (8.0, 2.0, 1.0), _AS_MEASURED, {"gauss-newton": _incidences},
        "Measure at two incidences or more; one does not determine clearcoat and sheen.",
    ),
    Mode(
        "mirror_fit", "fits to metals smoother than the smoothest parameter", "GGX roughness alpha",
        (0.1, 0.001, 0.0001), _HALF_OF_VALUES, {"gauss-newton": partial(_unreached, _mirror)},
        "For materials smoother than alpha 0.001 use Mitsuba's `conductor`, an ideal mirror.",
    ),
    Mode(
        "brushed_fit", "fits of isotropic parameters to brushed metals", "ratio of the two roughnesses",
        (1.0, 5.0, 10.0), _HALF_OF_VALUES, {"gauss-newton": partial(_unreached, brushed)},
        "Free `anisotropic` too, or keep the measured file.",
    ),
    Mode(
        "out_of_gamut", "colours outside the sRGB gamut (negative linear components)",
        "bandwidth of the reflectance in nm", (100.0, 15.0),
        Limit(
            "error of the fitted colour, in linear sRGB", 0.02, "twice the tolerance of a colour parameter"
        ),
        {method: partial(_colour, method) for method in FITTERS},
        "Render in spectral mode, where the fit keeps the reflectance of every band.",
    ),
)  # fmt: skip
