"""Fit a Mitsuba BSDF, by default `principled`, to reflectance samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from manifold.brdf.measured import BRDF, require_brdf
from manifold.errors import UsageError
from manifold.fitting import (
    adam_and_swarm,
    fit_metrics,
    fit_samples,
    gauss_newton,
    identifiability,
    undetermined,
)
from manifold.fitting.adam_and_swarm import AdamOptions, SwarmOptions
from manifold.fitting.bsdf_evaluation import Evaluator, evaluator
from manifold.fitting.bsdf_parameters import BsdfFamily, Layout, default_principled, diffuse
from manifold.fitting.fit_metrics import Metric
from manifold.fitting.fit_samples import FitSamples
from manifold.fitting.gauss_newton import GaussNewton, Minimum, Residuals
from manifold.fitting.identifiability import ParameterIdentifiability
from manifold.fitting.undetermined import TriedDefaults
from manifold.records import Array, Bands, BsdfFile, Progress
from manifold.rendering import backend

METHODS: Mapping[str, type] = {"gauss-newton": GaussNewton, "adam": AdamOptions, "swarm": SwarmOptions}
"""The methods by name, with the class of their hyperparameters."""

_POOR_FIT = (
    0.12  # relative residual: beyond it balls of measured materials look wrong, docs/design/principled.md
)

_LEAST_ANISOTROPY = 0.01  # alphas that differ by half a per cent

_MIXES_CHANNELS = ("spec_tint", "sheen_tint")  # principled's: their luminance has no meaning between bands


@dataclass(frozen=True)
class FittedMinimum:
    """One minimum of the residual.

    Attributes:
        values: by parameter; a list of three for a colour.
        residual: relative, in the metric of the fit.
        as_good: whether noise may hide its difference to the best.
        converged: whether the optimiser ended by itself.
    """

    values: dict[str, float | list[float]]
    residual: float
    as_good: bool
    converged: bool


@dataclass(frozen=True)
class FitResult:
    """A fitted BSDF, with residuals, minima and identifiability.

    Attributes:
        family: what was fitted.
        values: the best values by parameter; a list of three, linear sRGB, for a colour.
        bands: the bands of the samples.
        spectra: for spectral samples, values per band of the parameters per band, by name.
        method, metric: names.
        hyperparameters: of the method, with the assumed noise.
        residuals: relative residuals by metric, of the RGB fit.
        diffuse_residual: that of the best constant-albedo diffuse, in the metric of the fit.
        spectral_residual: in the metric of the fit over all bands; None for RGB samples.
        minima: all distinct minima found, best first.
        statements: how well the samples determine each value.
        notes: what a user should know, one line each.
        n_pairs: number of samples.
        variant: Mitsuba's.
        seconds: of the fit, reading and sampling left out.
    """

    family: BsdfFamily
    values: dict[str, float | list[float]]
    bands: Bands
    spectra: dict[str, list[float]]
    method: str
    metric: str
    hyperparameters: dict[str, Any]
    residuals: dict[str, float]
    diffuse_residual: float
    spectral_residual: float | None
    minima: tuple[FittedMinimum, ...]
    statements: tuple[ParameterIdentifiability, ...]
    notes: tuple[str, ...] = field(default=())
    n_pairs: int = 0
    variant: str = ""
    seconds: float = 0.0

    def __repr__(self) -> str:
        residual = f"{self.metric} residual {self.residuals[self.metric]:.2%}"
        return (
            f"<FitResult: {self.family.type}, {residual}, minima: {len(self.minima)}, values {self.values}>"
        )


@backend.variant_kept()
def fit_bsdf(
    target: BRDF | BsdfFile | FitSamples,
    family: BsdfFamily | None = None,
    *,
    method: str = "gauss-newton",
    metric: str = "cube-root",
    noise: float = 0.01,
    options: GaussNewton | AdamOptions | SwarmOptions | None = None,
    wide_colours: bool = False,
    on_progress: Progress | None = None,
) -> FitResult:
    """Fit the free parameters of a Mitsuba BSDF.

    Spectral samples are fitted in linear sRGB under D65 first; the parameters per band, such as the base colour, are
    then found in every band with the shared ones fixed.

    Args:
        target: a file (sampled where it was measured), any BRDF (sampled on a grid), or samples.
        family: the BSDF with its free parameters. If None, `default_principled`; and from method gauss-newton
            `diffuse()` where that fits better: no parameters make `principled` Lambertian.
        method: one of `METHODS`.
        metric: one of `fit_metrics.METRICS`, in which residuals are minimised and compared.
        noise: relative standard deviation of the samples that the statements assume at least.
        options: hyperparameters of the method.
        wide_colours: without a family, let base colours leave [0, 1], as colours outside Rec. 709 do.
        on_progress: called with how much of the stages of method gauss-newton is done.
    Raises:
        UsageError: the samples cannot be fitted, a name is unknown, or Mitsuba refuses the BSDF.
        RendererError: Mitsuba is missing, or lacks the backend that the method needs.
        ShapeError: the samples have wrong shapes or values that are no numbers.
    """
    options = _options(method, options)
    if not (np.isfinite(noise) and 0 < noise < 1):
        raise UsageError(f"noise {noise:g}, expected a share of the values between 0 and 1, such as 0.01")
    samples = _samples_of(target)
    if family is not None:
        return _fit(samples, family, method, metric, noise, options, on_progress)
    default = default_principled(samples.is_isotropic, wide_colours=wide_colours)
    found = _fit(samples, default, method, metric, noise, options, on_progress)
    is_worse = _is_worse_than_diffuse(found.residuals[metric], found.diffuse_residual)
    if method != "gauss-newton" or not is_worse:
        return found
    plain = _fit(samples, diffuse(wide_colours=wide_colours), method, metric, noise, options)
    if plain.residuals[metric] >= found.residuals[metric]:  # no reflectance that a surface can have
        return found
    note = f"diffuse: principled fits worse ({found.residuals[metric]:.2%} against {plain.residuals[metric]:.2%})"
    return replace(plain, notes=(note, *plain.notes), seconds=found.seconds + plain.seconds)


def _fit(
    samples: FitSamples, family: BsdfFamily, method: str, metric: str, noise: float, options: Any,
    on_progress: Progress | None = None,
) -> FitResult:  # fmt: skip
    if not samples.bands.is_rgb:
        _require_independent_bands(family)
    rgb = samples.as_rgb()
    measure = Metric.of(metric, rgb)
    whole = evaluator(family, rgb.wi, rgb.wo, 3)
    tried = TriedDefaults.none(whole.layout.size)
    start = time.perf_counter()
    with threadpool_limits(1):  # small matrices: threads would only wait for each other
        if isinstance(options, GaussNewton):
            rows = gauss_newton.coarse_rows(rgb, options)
            coarse = evaluator(family, rgb.wi[rows], rgb.wo[rows], 3)
            minima = gauss_newton.find_minima(whole, rgb, measure, options, coarse, on_progress)
            judged = _judge(whole, rgb, measure, minima, noise, tried)
            best, tried = undetermined.keep_undetermined(
                Residuals(whole, rgb, measure), minima[0], judged.statements, judged.is_as_good, options
            )
            minima = [best, *minima[1:]]
        elif isinstance(options, AdamOptions):
            minima = [adam_and_swarm.adam(family, rgb, whole, measure, options)]
        else:
            minima = [adam_and_swarm.swarm(family, rgb, whole, measure, options)]
        spectra, spectral_residual = _fit_spectra(family, samples, metric, minima[0].p, whole.layout)
    seconds = time.perf_counter() - start
    return _result(
        family, samples, rgb, whole, measure, minima, noise, tried,
        method=method, hyperparameters=asdict(options) | {"noise": noise}, spectra=spectra,
        spectral_residual=spectral_residual, seconds=seconds,
    )  # fmt: skip


def _samples_of(target: BRDF | BsdfFile | FitSamples) -> FitSamples:
    if isinstance(target, FitSamples):
        return target
    if isinstance(target, BsdfFile):
        return fit_samples.from_file(target)
    require_brdf(target, "what is fitted")
    return fit_samples.from_brdf(target)


def _options(method: str, options: Any) -> Any:
    if method not in METHODS:
        raise UsageError(f"no method is called {method!r}, expected one of {', '.join(METHODS)}")
    if options is None:
        return METHODS[method]()
    if not isinstance(options, METHODS[method]):
        raise UsageError(f"method {method} got {type(options).__name__}, expected {METHODS[method].__name__}")
    return options


def _require_independent_bands(family: BsdfFamily) -> None:
    """Tints depend on a luminance of three channels, which three bands of a spectrum do not have."""
    mixing = [
        name
        for name in _MIXES_CHANNELS
        if any(o.name == name for o in family.parameters) or family.fixed.get(name, 0)
    ]
    if family.type == "principled" and mixing:
        raise UsageError(
            f"{' and '.join(mixing)} need RGB samples: a tint has no meaning per band; leave them out, or fit RGB"
        )


def _noise_variance(samples: FitSamples, metric: Metric, noise: float) -> float:
    """Variance of a residual that relative noise of the samples causes, averaged over them."""
    y = samples.f_cos
    return float(np.mean(samples.weight[:, None] * (metric.slope(y) * noise * y) ** 2))


def _fit_spectra(
    family: BsdfFamily, samples: FitSamples, metric: str, p: Array, layout: Layout
) -> tuple[dict[str, list[float]], float | None]:
    """Values per band of the parameters per band, the shared ones fixed, and the relative residual."""
    own = [o for o in family.parameters if o.per_band]
    if samples.bands.is_rgb or not own:
        return {}, None
    measure = Metric.of(metric, samples)
    bands = evaluator(family, samples.wi, samples.wo, samples.bands.count)
    q, value = gauss_newton.refine_bands(bands, samples, measure, layout.with_bands(p, samples.bands.count))
    split = bands.layout.split(q)
    return (
        {o.name: split[o.name] for o in own},  # type: ignore[misc]
        fit_metrics.relative_residual(samples, measure, value),
    )


@dataclass(frozen=True, eq=False)
class _Judged:
    """Minima, those worth listing, beside each other."""

    minima: list[Minimum]
    as_good: list[bool]
    statements: tuple[ParameterIdentifiability, ...]
    n_different: int
    residual: Array
    J: Array
    is_as_good: Callable[[float, float], bool]


def _judge(
    whole: Evaluator,
    rgb: FitSamples,
    metric: Metric,
    minima: list[Minimum],
    noise: float,
    tried: TriedDefaults,
) -> _Judged:
    """Minima as good as the first, and the identifiability of its values."""
    layout, best = whole.layout, minima[0]
    residual, J = Residuals(whole, rgb, metric).by_parameter(best.p)
    variance = identifiability.residual_variance(residual, layout.size, _noise_variance(rgb, metric, noise))

    def is_as_good(cost: float, best: float) -> bool:
        return identifiability.is_as_good(cost, best, variance, layout.size)

    minima = gauss_newton.select_minima(minima, is_as_good)
    as_good = [is_as_good(one.cost, best.cost) for one in minima]
    others = [one.p for one, good in zip(minima[1:], as_good[1:], strict=True) if good]
    statements = identifiability.identify_parameters(layout, best.p, J, variance, others, tried.kept)
    statements = tuple(
        replace(s, state=identifiability.UNCERTAIN) if refused and s.state == identifiability.UNSEEN else s
        for s, refused in zip(statements, tried.refused, strict=True)
    )
    n_different = sum(identifiability.is_different(layout, best.p, p, statements) for p in others)
    return _Judged(minima, as_good, statements, n_different, residual, J, is_as_good)


def _result(
    family: BsdfFamily, samples: FitSamples, rgb: FitSamples, whole: Evaluator, metric: Metric,
    minima: list[Minimum], noise: float, tried: TriedDefaults, **known: Any,
) -> FitResult:  # fmt: skip
    layout, best = whole.layout, minima[0]
    judged = _judge(whole, rgb, metric, minima, noise, tried)
    statements = judged.statements
    step, cost = identifiability.gauss_newton_step(layout, best.p, judged.residual, judged.J)
    step[tried.kept] = 0.0
    most = int(np.argmax(np.abs(step) / layout.tolerance))
    is_minimum = judged.is_as_good(best.cost, cost) or np.abs(step[most]) <= layout.tolerance[most]
    norm = fit_metrics.norm(rgb, metric)
    diffuse = np.sqrt(fit_metrics.best_diffuse(rgb, metric)[1]) / norm
    values = layout.split(best.p)
    residuals = fit_metrics.relative_residuals(rgb, whole.values(best.p)[0])
    return FitResult(
        family=family,
        values=values,
        bands=samples.bands,
        metric=metric.name,
        residuals=residuals,
        diffuse_residual=float(diffuse),
        minima=tuple(
            FittedMinimum(layout.split(one.p), float(np.sqrt(one.cost) / norm), good, one.converged)
            for one, good in zip(judged.minima, judged.as_good, strict=True)
        ),
        statements=statements,
        notes=tuple(
            _notes(family, values, statements, judged.n_different, residuals[metric.name], float(diffuse))
            + _notes_on_anisotropy(family, values, samples)
            + [
                f"not a minimum of the {metric.name} residual: a Gauss-Newton step moves "
                f"{layout.labels[most]} by {step[most]:+.3f}; use --method gauss-newton"
            ]
            * (not is_minimum)
        ),
        n_pairs=len(samples),
        variant=backend.mitsuba(colour="rgb").variant(),
        **known,
    )


def _notes(
    family: BsdfFamily, values: Mapping[str, Any], statements: tuple[ParameterIdentifiability, ...], n_others: int,
    residual: float, diffuse: float,
) -> list[str]:  # fmt: skip
    notes = []
    for o in family.parameters:
        if o.per_band and (min(values[o.name]) < 0 or max(values[o.name]) > 1) and o.maximum <= 2:
            colour = ", ".join(f"{v:.3f}" for v in values[o.name])
            notes.append(f"{o.name} ({colour}) lies outside Rec. 709; it is not clamped")
    ends = [s.name for s in statements if s.at_bound]
    if ends:
        notes.append(f"at the end of the range: {', '.join(ends)}")
    if n_others:
        notes.append(f"ambiguous: {n_others + 1} solutions fit equally well within the noise; all are listed")
    unknown = [s.name for s in statements if s.state == identifiability.UNSEEN and not s.is_kept]
    if unknown:
        notes.append(f"not determined by the data: {', '.join(unknown)}")
    kept = [s.name for s in statements if s.is_kept]
    if kept:
        notes.append(f"not determined by the data, left at the defaults: {', '.join(kept)}")
    if _is_worse_than_diffuse(residual, diffuse):
        notes.append(f"no better than a diffuse surface ({residual:.3f} against {diffuse:.3f})")
    if residual > _POOR_FIT:
        notes.append(f"{family.type} does not fit these samples: relative residual {100.0 * residual:.0f} %")
    return notes


def _notes_on_anisotropy(family: BsdfFamily, values: Mapping[str, Any], samples: FitSamples) -> list[str]:
    """Of an anisotropic material that is fitted the same at all azimuths."""
    if (
        samples.is_isotropic
        or family.type not in ("principled", "diffuse")
        or family.fixed.get("anisotropic")
    ):
        return []
    if "anisotropic" not in values:
        return ["anisotropic, but fitted the same at all azimuths: let `anisotropic` be free"]
    if values["anisotropic"] < _LEAST_ANISOTROPY:
        return [
            "anisotropic, but fitted the same at all azimuths: principled's highlights are wider along x; where the "
            "sample's are wider along y, turn it by a quarter about its normal"
        ]
    return []


def _is_worse_than_diffuse(residual: float, diffuse: float) -> bool:
    return residual > diffuse * (1.0 + 1e-6)  # both are found by iteration
