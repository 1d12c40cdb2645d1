"""Direct fits as entries of a fit's JSON: `manifold fit --target` writes them, `manifold export` reads them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from manifold.colour import ball_colours
from manifold.errors import FileFormatError, UsageError
from manifold.fitting import fit_json, fit_samples
from manifold.fitting.bsdf_parameters import is_number
from manifold.fitting.exports import loss
from manifold.fitting.exports.direct import fit_target, parameter_range
from manifold.fitting.exports.principled_values import Principled
from manifold.fitting.exports.targets import TARGETS, Target
from manifold.fitting.fit_metrics import Metric, relative_residual
from manifold.fitting.fit_samples import EvaluableBRDF
from manifold.fitting.fitted_brdf import FittedBRDF


def with_target(
    content: Mapping[str, Any], target: Target, material: EvaluableBRDF, against: str
) -> dict[str, Any]:
    """The content of a fit's JSON with the entry `target`: that target's own model, fitted.

    Args:
        content: as `fit_json.document` made it, a fit of `principled` or `diffuse`, where the search starts.
        target: whose model is fitted.
        material: what was fitted.
        against: that in words, `measured file` or `prediction`.
    Raises:
        UsageError: the fit has no counterpart in engines.
    """
    mapped = target.parameters(Principled.from_fit(content["bsdf"], content["values"]))
    samples = fit_samples.from_brdf(material).as_rgb()
    metric = Metric.of("cube-root", samples)
    found = fit_target(target, mapped, samples, material)
    reference = loss.material_xyz(material)

    def errors(values: Mapping[str, Any]) -> dict[str, float]:
        f_cos = target.brdf(values, samples.wi, samples.wo) * samples.wo[:, 2:]
        seen = loss.rgb_xyz(lambda view, light: target.brdf(values, view, light))
        return {
            "residual": relative_residual(samples, metric, f_cos),
            "ciede2000": ball_colours.delta_e(seen, reference),
        }

    of_principled = ball_colours.delta_e(loss.material_xyz(FittedBRDF(dict(content))), reference)
    entry = {"name": target.name, "parameters": found, "against": against} | errors(found)
    entry |= {f"mapped_{key}": value for key, value in errors(mapped).items()}
    return fit_json.signed(dict(content) | {"target": entry | {"principled_ciede2000": of_principled}})


def parameters(entry: Mapping[str, Any], target: Target, file: str) -> dict[str, Any]:
    """The parameters of a fit's entry `target`.

    Args:
        entry: of the JSON, as its schema describes it.
        target: whose parameters are wanted; targets of one model share them.
        file: its name, for errors.
    Raises:
        UsageError: the entry is of another model.
        FileFormatError: a parameter is missing, unknown or out of range.
    """
    known = TARGETS.get(entry["name"])
    if known is None or known.brdf is not target.brdf:
        raise UsageError(
            f"{file}: a fit of the model of {entry['name']!r}, expected {target.name}; fit with --target "
            f"{next(t.name for t in TARGETS.values() if t.brdf is target.brdf)}, or without --target for all targets"
        )
    found = entry["parameters"]
    if found.keys() != target.defaults.keys():
        differing = ", ".join(sorted(found.keys() ^ target.defaults.keys()))
        raise FileFormatError(f"{file}: target.parameters are missing or unknown: {differing}; fit again")
    for name, default in target.defaults.items():
        low, high = parameter_range(name)
        low, high = (0.0, 1.0) if high <= 1.0 else (min(low, default), high)  # no film has thickness 0
        wanted = 3 if isinstance(default, list) else 1
        values = found[name] if wanted == 3 else [found[name]]
        is_right = isinstance(values, list) and len(values) == wanted
        if not is_right or not all(is_number(value) and low <= value <= high for value in values):
            kind = "3 numbers" if wanted == 3 else "a number"
            raise FileFormatError(
                f"{file}: target.parameters.{name} is not {kind} from {low:g} to {high:g}; correct it, or fit again"
            )
    return dict(found)
