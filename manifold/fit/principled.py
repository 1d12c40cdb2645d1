"""Fit a Mitsuba BSDF, by default `principled`, to reflectance samples."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from manifold.brdf.interface import BRDF, require_brdf
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.orientation import rotation_of, rotation_of_brdf
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.colour.difference import VISIBLE
from manifold.core.errors import UnknownNameError, UsageError
from manifold.core.judged_lights import BALL, BALL_COLUMN
from manifold.core.metrics import Errors
from manifold.core.names import exceeds, names_like, percent
from manifold.core.records import Array, Bands, BsdfFile
from manifold.core.results import Result, entry
from manifold.fit import adam_and_swarm, fit_metrics, fit_samples, gauss_newton, identifiability
from manifold.fit.adam_and_swarm import AdamOptions, SwarmOptions
from manifold.fit.fit_metrics import Criterion, ball_errors
from manifold.fit.fit_samples import FitSamples
from manifold.fit.gauss_newton import GaussNewton, Minimum, Residuals
from manifold.fit.identifiability import ParameterIdentifiability, TriedDefaults
from manifold.registries import FITTERS
from manifold.render import backend
from manifold.render.bsdf_evaluation import require_independent_bands, variant
from manifold.render.bsdf_parameters import BsdfFamily, default_principled, diffuse
from manifold.render.fitted_brdf import FittedBRDF

_POOR_FIT = (
    0.12  # relative residual: beyond it balls of measured materials look wrong, docs/explanation/fits.md
)


@dataclass(frozen=True)
class FittedMinimum:
    """One minimum of the residual.

    Attributes:
        values: values by parameter; a list of three for a colour.
        residual: relative residual in the metric of the fit.
        as_good: whether noise can explain its difference from the best minimum.
        converged: whether the optimiser converged before its limit.
    """

    values: dict[str, float | list[float]]
    residual: float
    as_good: bool
    converged: bool


@dataclass(frozen=True, kw_only=True)
class FitResult(Result):
    """A fitted BSDF, with residuals, minima and identifiability; `fits.document` is its JSON.

    Attributes:
        family: the BSDF that was fitted, and its free parameters.
        values: the best values by parameter; a list of three, linear sRGB, for a colour.
        bands: the bands of the samples.
        spectra: for spectral samples, the values of parameters that differ between bands, one per band, by name.
        method, metric: names of the method and the metric.
        hyperparameters: hyperparameters of the method, and the assumed noise.
        residuals: relative residuals of the RGB fit, by metric.
        diffuse_residual: relative residual of the best diffuse BRDF of constant albedo, in the metric of the fit.
        errors: errors of the fit's ball; None if the material is known only at samples.
        spectral_residual: relative residual over all bands, in the metric of the fit; None for RGB samples.
        minima: all distinct minima found, best first.
        statements: how well the samples determine each value.
        notes: sentences for users, one line each.
        n_pairs: number of samples.
        variant: evaluator of the BSDF, `numpy` or the name of a Mitsuba variant.
        seconds: duration of the fit, without reading and sampling.
        rotation_deg: azimuth, from x, along which the material's highlights are widest; the BSDF's highlights are
            widest along x.
    """

    family: BsdfFamily = field(metadata=entry(columns={"BSDF": lambda content: content["bsdf"]["type"]}))
    values: dict[str, float | list[float]]
    bands: Bands
    spectra: dict[str, list[float]]
    method: str
    metric: str
    hyperparameters: dict[str, Any]
    errors: Errors[float] | None = field(
        default=None, metadata=entry(row="CIEDE2000 of the ball", columns={BALL_COLUMN: ("ball",)})
    )
    residuals: dict[str, float] = field(
        metadata=entry(
            row="relative residual", words=lambda fit: [f"{name} {value:.3f}" for name, value in fit.residuals.items()],
            columns={"residual": lambda content: content["residuals"][content["metric"]]},
        )
    )  # fmt: skip
    diffuse_residual: float = field(
        metadata=entry(
            row="best Lambertian fit", words=lambda fit: f"relative residual {fit.diffuse_residual:.3f} ({fit.metric})",
            columns={"diffuse": ()},
        )
    )  # fmt: skip
    spectral_residual: float | None = field(
        metadata=entry(row="all bands", words=lambda fit: f"{fit.metric} {fit.spectral_residual:.3f}")
    )
    minima: tuple[FittedMinimum, ...] = field(
        metadata=entry(
            row="other minima", columns={"minima": lambda content: len(content["minima"])},
            words=lambda fit: [f"{minimum.residual:.3f}" + " (as good)" * minimum.as_good for minimum in fit.minima[1:]]
            or "none found",
        )
    )  # fmt: skip
    statements: tuple[ParameterIdentifiability, ...]
    notes: tuple[str, ...] = ()
    n_pairs: int = 0
    variant: str = ""
    seconds: float = 0.0
    rotation_deg: float = 0.0

    @classmethod
    def of_document(cls, content: Mapping[str, Any]) -> FitResult:
        """Return the fit that a JSON document holds, see `fits.document`; without spectra its bands are RGB."""
        known = {shown.name: content[shown.name] for shown in fields(cls) if shown.name in content}
        spectra = content["spectra"] or {"values": {}, "wavelengths_nm": None}
        return cls(
            **known
            | {
                "family": BsdfFamily.from_json(content["bsdf"]),
                "bands": Bands(spectra["wavelengths_nm"]),
                "spectra": spectra["values"],
                "errors": content["errors"] and Errors(**content["errors"]),
                "minima": tuple(FittedMinimum(**minimum) for minimum in content["minima"]),
                "statements": tuple(ParameterIdentifiability(**each) for each in content["statements"]),
            }
        )

    @property
    def rows(self) -> dict[str, object]:
        """Return the rows of the fit's table, by label, beginning with how well every value is determined."""
        return {each.name: str(each) for each in self.statements} | super().rows

    @property
    def brdf(self) -> FittedBRDF:
        """The fit, as a BRDF."""
        return FittedBRDF.of(self.family, self.values, self.bands, self.spectra, self.rotation_deg)

    def __repr__(self) -> str:
        residual = f"{self.metric} residual {percent(self.residuals[self.metric], 2)}"
        return (
            f"<FitResult: {self.family.type}, {residual}, minima: {len(self.minima)}, values {self.values}>"
        )


@backend.variant_kept()
def fit_bsdf(
    target: BRDF | BsdfFile | FitSamples,
    family: BsdfFamily | str | None = None,
    *,
    method: str = "gauss-newton",
    metric: str = "appearance",
    noise: float = 0.01,
    options: GaussNewton | AdamOptions | SwarmOptions | None = None,
    wide_colours: bool = False,
) -> FitResult:
    """Fit the free parameters of a Mitsuba BSDF; only BSDFs other than `principled` and `diffuse` need Mitsuba.

    Spectral samples are fitted in linear sRGB under D65 first; the parameters per band, such as the base colour, are
    then found in every band with the shared ones fixed.

    Args:
        target: a file (its unmeasured cells are filled), any BRDF, or samples. Files and BRDFs are sampled on a grid;
            anisotropic ones are first turned so that their highlights are wide along x, as those of `principled` are.
            A ball is rendered in separate lights for the fit and for its error.
        family: the BSDF with its free parameters, or the name `principled` or `diffuse` for the usual ones. None
            means `default_principled`, or with the method gauss-newton `diffuse()` if that fits better, because
            `principled` cannot be Lambertian.
        method: one of `FITTERS`.
        metric: one of `fit_metrics.METRICS`, in which residuals are minimised and compared. `appearance` compares the
            colours of the ball and the cube roots of the samples; without a ball, only the cube roots.
        noise: lower bound of the samples' relative standard deviation, for the statements on identifiability.
        options: hyperparameters of the method.
        wide_colours: whether, without a family, base colours may leave [0, 1], like colours outside Rec. 709.

    Raises:
        UsageError: the samples cannot be fitted, a name is unknown, or Mitsuba refuses the BSDF.
        RendererError: the BSDF is neither `principled` nor `diffuse`, and Mitsuba or its LLVM backend is missing.
        ShapeError: the samples have wrong shapes, or values that are not numbers.
    """
    if options is None:
        options = FITTERS[method]()
    elif not isinstance(options, FITTERS[method]):
        raise UsageError(f"method {method} got {type(options).__name__}, expected {FITTERS[method].__name__}")
    if not (np.isfinite(noise) and 0 < noise < 1):
        raise UsageError(f"noise {noise:g}, expected a share of the values between 0 and 1, such as 0.01")
    rotation: float | None = None
    if isinstance(target, BsdfFile):
        if (rotation := rotation_of(target)) is not None:
            rotation -= target.rotation_rad
        target = MeasuredBRDF(fill_unmeasured(target))
    elif not isinstance(target, FitSamples):
        require_brdf(target, "the material to fit")
        rotation = rotation_of_brdf(target)
    if isinstance(target, FitSamples):
        return _fit_or_diffuse(target, family, method, metric, noise, options, wide_colours)
    samples = fit_samples.from_brdf(target, rotation or 0.0)
    found = _fit_or_diffuse(samples, family, method, metric, noise, options, wide_colours)
    degrees = round(float(np.rad2deg(rotation or 0.0)) % 180.0, 1) % 180.0  # highlights have no ends
    degrees = 0.0 if found.brdf.is_isotropic else degrees
    fitted = replace(found, rotation_deg=degrees).brdf
    errors = ball_errors(fitted, target)
    notes = found.notes
    if degrees:
        notes += (
            f"turned: highlights are wide along {degrees:.1f} degrees from x (rotation_deg), those of the BSDF along "
            "x; in Mitsuba, turn the tangents by it",
        )
    if exceeds(errors.ball, VISIBLE, 1):
        worst = f"{errors.worst:.1f} in {errors.worst_light}"
        notes += (f"not a close fit: {errors.ball:.1f} {BALL}, above {VISIBLE:g}; {worst}",)
        if (missed := fit_metrics.missed_highlight(fitted, target)) is not None:
            notes += (missed,)
    return replace(found, errors=errors, notes=notes, rotation_deg=degrees)


def _fit_or_diffuse(
    samples: FitSamples, family: BsdfFamily | str | None, method: str, metric: str, noise: float, options: Any,
    wide_colours: bool,
) -> FitResult:  # fmt: skip
    """Fit the family, or the default one."""
    default = default_principled(samples.is_isotropic, wide_colours=wide_colours)
    named = {default.type: default, "diffuse": diffuse(wide_colours=wide_colours)}
    if isinstance(family, str):
        if family not in named:
            raise UnknownNameError(
                f"no BSDF '{family}' to fit; {names_like(named, family, 'names are')}; give another BSDF as a "
                "BsdfFamily"
            )
        family = named[family]
    if family is not None:
        return _fit(samples, family, method, metric, noise, options)
    found = _fit(samples, default, method, metric, noise, options)
    is_worse = _is_worse_than_diffuse(found.residuals[metric], found.diffuse_residual)
    if method != "gauss-newton" or not is_worse:
        return found
    plain = _fit(samples, named["diffuse"], method, metric, noise, options)
    if plain.residuals[metric] >= found.residuals[metric]:  # no reflectance that a surface can have
        return found
    worse, better = (percent(each.residuals[metric], 2) for each in (found, plain))
    note = f"diffuse: principled fits worse ({worse} against {better})"
    return replace(plain, notes=(note, *plain.notes), seconds=found.seconds + plain.seconds)


def _fit(
    samples: FitSamples, family: BsdfFamily, method: str, metric: str, noise: float, options: Any,
) -> FitResult:  # fmt: skip
    if not samples.bands.is_rgb:
        require_independent_bands(family)
    rgb = samples.as_rgb()
    residuals = Residuals(family, Criterion(rgb, metric))
    layout = residuals.layout
    tried = TriedDefaults.none(layout.size)
    start = time.perf_counter()
    with threadpool_limits(1), backend.one_thread():  # small matrices and launches: threads would only wait
        if isinstance(options, GaussNewton):
            minima = gauss_newton.find_minima(residuals, options)
            assessed = _assess(residuals, minima, noise, tried)
            best, tried = identifiability.keep_undetermined(
                residuals, minima[0], assessed.statements, assessed.limit, options
            )
            minima = [best, *minima[1:]]
        elif isinstance(options, AdamOptions):
            minima = [adam_and_swarm.adam(family, rgb, residuals, options)]
        else:
            minima = [adam_and_swarm.swarm(family, rgb, residuals, options)]
        spectra: dict[str, list[float]] = {}
        spectral_residual: float | None = None
        per_band = [o.name for o in family.parameters if o.per_band]
        if per_band and not samples.bands.is_rgb:  # the shared parameters are fixed
            of_bands, spectral_residual = gauss_newton.refine_bands(
                family, samples, metric, layout.split(minima[0].p)
            )
            spectra = {name: of_bands[name] for name in per_band}  # type: ignore[misc]
    seconds = time.perf_counter() - start
    return _result(
        family, samples, residuals, minima, noise, tried, method=method, spectra=spectra,
        hyperparameters=asdict(options) | {"noise": noise}, spectral_residual=spectral_residual, seconds=seconds,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Assessment:
    """Minima worth listing, and how well the samples determine the values of the first.

    Attributes:
        minima, is_as_good: best first, and whether noise may hide the difference of each to the best.
        statements: of the K values of the best.
        n_different: minima as good as the best with values that differ beyond their errors.
        residual, J: at the best, shapes (n,) and (n, K).
        limit: difference of two costs that noise may hide.
    """

    minima: list[Minimum]
    is_as_good: list[bool]
    statements: tuple[ParameterIdentifiability, ...]
    n_different: int
    residual: Array
    J: Array
    limit: float


def _assess(residuals: Residuals, minima: list[Minimum], noise: float, tried: TriedDefaults) -> _Assessment:
    layout, best = residuals.layout, minima[0]
    residual, J = residuals.by_parameter(best.p)
    # Variance of a residual that relative noise of the samples causes, averaged over them.
    criterion = residuals.criterion
    y, weight = criterion.samples.f_cos, criterion.samples.weight[:, None]
    assumed = float(np.mean(weight * (criterion.metric.slope(y) * noise * y) ** 2))
    variance = identifiability.residual_variance(residual, layout.size, assumed)
    limit = identifiability.as_good_limit(variance, layout.size)
    minima = gauss_newton.select_minima(minima, limit)
    is_as_good = [minimum.cost - best.cost <= limit for minimum in minima]
    others = [minimum.p for minimum, good in zip(minima[1:], is_as_good[1:], strict=True) if good]
    statements = identifiability.identify_parameters(layout, best.p, J, variance, others, tried.kept)
    statements = tuple(
        replace(s, state=identifiability.UNCERTAIN) if refused and s.state == identifiability.UNSEEN else s
        for s, refused in zip(statements, tried.refused, strict=True)
    )
    n_different = sum(identifiability.is_different(layout, best.p, p, statements) for p in others)
    return _Assessment(minima, is_as_good, statements, n_different, residual, J, limit)


def _result(
    family: BsdfFamily, samples: FitSamples, residuals: Residuals, minima: list[Minimum], noise: float,
    tried: TriedDefaults, **known: Any,
) -> FitResult:  # fmt: skip
    layout, best, criterion = residuals.layout, minima[0], residuals.criterion
    metric, norm = criterion.metric.name, criterion.norm
    assessed = _assess(residuals, minima, noise, tried)
    everywhere = residuals.evaluator
    if metric != "appearance":
        everywhere = Residuals(family, Criterion(criterion.samples, "appearance")).evaluator
    result = FitResult(
        family=family,
        values=layout.split(best.p),
        bands=samples.bands,
        metric=metric,
        residuals=fit_metrics.relative_residuals(criterion.samples, everywhere.values(best.p)[0]),
        diffuse_residual=float(np.sqrt(fit_metrics.best_diffuse(criterion)[1]) / norm),
        minima=tuple(
            FittedMinimum(
                layout.split(minimum.p), float(np.sqrt(minimum.cost) / norm), good, minimum.converged
            )
            for minimum, good in zip(assessed.minima, assessed.is_as_good, strict=True)
        ),
        statements=assessed.statements,
        n_pairs=len(samples),
        variant=variant(family),
        **known,
    )
    notes = _notes(result, assessed.n_different, samples.is_isotropic)
    step, cost = identifiability.gauss_newton_step(layout, best.p, assessed.residual, assessed.J)
    step[tried.kept] = 0.0
    most = int(np.argmax(np.abs(step) / layout.tolerance))
    is_other = result.method != "gauss-newton"
    if is_other and best.cost - cost > assessed.limit and np.abs(step[most]) > layout.tolerance[most]:
        notes.append(
            f"not a minimum of the {metric} residual: a Gauss-Newton step moves {layout.labels[most]} by "
            f"{step[most]:+.3f}; use method gauss-newton"
        )
    return replace(result, notes=tuple(notes))


def _notes(result: FitResult, n_others: int, is_isotropic: bool) -> list[str]:
    """Return the notes on a fit that a user should know."""
    notes, statements = [], result.statements
    for o in result.family.parameters:
        value = result.values[o.name]
        if isinstance(value, list) and (min(value) < 0 or max(value) > 1) and o.maximum <= 2:
            colour = ", ".join(f"{v:.3f}" for v in value)
            notes.append(f"{o.name} ({colour}) lies outside Rec. 709; it is not clamped")
    if ends := [s.name for s in statements if s.at_bound]:
        notes.append(f"at the end of the range: {', '.join(ends)}")
    if n_others:
        notes.append(f"ambiguous: {n_others + 1} solutions fit equally well within the noise; all are listed")
    if unknown := [s.name for s in statements if s.state == identifiability.UNSEEN and not s.is_kept]:
        notes.append(f"not determined by the data: {', '.join(unknown)}")
    if kept := [s.name for s in statements if s.is_kept]:
        notes.append(f"not determined by the data, left at the defaults: {', '.join(kept)}")
    residual, diffuse = result.residuals[result.metric], result.diffuse_residual
    if _is_worse_than_diffuse(residual, diffuse):
        notes.append(f"no better than a diffuse surface ({residual:.3f} against {diffuse:.3f})")
    if residual > _POOR_FIT:
        notes.append(
            f"{result.family.type} does not fit these samples: relative residual {100.0 * residual:.0f} %"
        )
    is_known = result.family.type in ("principled", "diffuse") and not result.family.fixed.get("anisotropic")
    anisotropic = result.values.get("anisotropic")
    if is_isotropic or not is_known:
        return notes
    if anisotropic is None:
        notes.append("anisotropic, but fitted as isotropic; free the parameter `anisotropic`")
    elif isinstance(anisotropic, float) and anisotropic < identifiability.BOUND:
        notes.append(
            "anisotropic, but fitted the same at all azimuths: principled's highlights are wider along x; where the "
            "sample's are wider along y, rotate it by 90 degrees about its normal"
        )
    return notes


def _is_worse_than_diffuse(residual: float, diffuse: float) -> bool:
    return residual > diffuse * (1.0 + 1e-6)  # both are found by iteration
