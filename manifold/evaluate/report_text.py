"""Formats a report as text."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence

import numpy as np

from manifold.core.judged_lights import BALL, JUDGED, LIGHTS
from manifold.core.names import counted, percent
from manifold.core.text_tables import table_lines
from manifold.evaluate.coherences import THIS_MODEL
from manifold.evaluate.report import MethodResult, Report
from manifold.model.coherence import FAR, NEIGHBOURS_COMPARED
from manifold.model.expected_error import LEVEL, NOT_CALIBRATED

_WIDTH = 80
_SHOWN_COORDINATES = 2  # coordinates of a latent, so that a row fits 80 columns
# Methods whose errors every material shows: column title per key, most honest first, as many as fit.
_MATERIAL_COLUMNS = {
    "blend_refitted": "refitted",
    "blend_encoded": "kept",
    "gp_refitted": "refitted",
    "gp_encoded": "others kept",
    "gp_latents_kept": "kept",
    "linear": "linear",
    "nearest": "nearest",
}
_SHOWN_METHODS = 4
_PCA, _BEFORE_PCA = "pca_", ("nearest", "linear", "oracle")  # keys
_OWN_METHODS = ("blend_refitted", "gp_refitted", "blend_encoded", "gp_encoded")  # most honest first
_LOWEST_RMS, _HIGHEST_RMS = 0.5, 2.0  # root mean squares between which a method counts as calibrated
_MANY_DIGITS = 1e5
_KINDS = {
    "blend": "Blends of materials: {}, and a colour coordinate and a gain per band",
    "gplvm": "GPLVM of whole materials: {}",
}
_PER_BAND = "Q + 2 per band: Q coordinates for all bands, and a colour coordinate and a gain per band."
_LEGEND = {
    "reconstruction": "at its own latent: of a library material, predicted as measured (training error).",
    "smooth": "without delta: at its own latent, by the posterior mean without the kernel's delta.",
    "gp_latents_kept": "latents kept: the latents were fitted with the material; only its values are left out of the "
    "prediction (optimistic).",
    "gp_encoded": "others' latents kept: the latents were fitted with the material, which is then located from its "
    "values (optimistic).",
    "blend_encoded": "latents kept: the map was fitted with the material, which is then located from its values and "
    "predicted from the others (optimistic).",
    "blend_refitted": "refitted: the model is fitted to the other materials; the left-out one is then located from its "
    "values.",
    "gp_refitted": "refitted: the model is fitted to the other materials; the left-out one is then located from its "
    "values.",
    "oracle": "oracle: the left-out material decides which two are mixed.",
    "nonnegative": "non-negative least squares: `manifold reconstruct` from the other materials.",
    "few_atoms": "few samples and lobes: `manifold reconstruct --numbers`, with three samples or lobes.",
    "blend_2": _PER_BAND,
    "blend_3": _PER_BAND,
    "principled": "principled: fitted to the material itself.",
}
"""Explanations of methods, by key; one is printed only if a row needs it."""

Columns = Sequence[tuple[str, Callable[[MethodResult], str]]]
"""Titles of columns, and the values of a method in them."""

_ERRORS: Columns = (
    ("CIEDE2000", lambda m: f"{m.median.ball:.2f}"),
    ("p90", lambda m: f"{m.p90.ball:.2f}"),
    ("cube root", lambda m: _fixed(m.median.cube_root)),
    ("p90", lambda m: _fixed(m.p90.cube_root)),
    ("linear", lambda m: _fixed(m.median.linear)),
    ("p90", lambda m: _fixed(m.p90.linear)),
)
_ERROR_NOTE = (
    "Medians and 90th percentiles (p90) over materials.",
    f"CIEDE2000: of the ball, mean of the {LIGHTS}.",
    "cube root: relative error of cube roots of cosine-weighted values, closer to perceived differences.",
    "linear: relative error of cosine-weighted values, dominated by highlights.",
)

_LIGHTS: Columns = (
    *((name.removesuffix(" 0"), lambda m, name=name: f"{m.median.lights[name]:.2f}") for name in JUDGED),
    ("worst", lambda m: f"{m.median.worst:.1f}"),
    ("p90", lambda m: f"{m.p90.worst:.1f}"),
)
_LIGHTS_NOTE = (
    "Median CIEDE2000 of the ball in the test lights: studio, uniform white, suns at these angles from the "
    "view, in degrees.",
    "worst, p90: median and 90th percentile over the materials, each in its worst light.",
)


def _short(error: float) -> str:
    """Format an error of values in 1/sr; from 100 on without decimals."""
    return f"{error:,.0f}" if error >= 100.0 else f"{error:.3f}"


_PLAUSIBILITY: Columns = (
    ("RMSE", lambda m: _short(m.median.rmse)),
    ("RMSE 80", lambda m: _short(m.median.rmse_80)),
    ("negative", lambda m: percent(m.negative_share, 2)),
    ("recip.", lambda m: f"{m.reciprocity_error:.3f}"),
    ("albedo", lambda m: f"{m.max_albedo:.2f}"),
    ("ball ITP", lambda m: f"{m.median.ball_itp:.1f}"),
)
_PLAUSIBILITY_NOTE = (
    "RMSE: Hikichi & Iwasaki, eq. 22, median, 1/sr, dominated by a few directions at the horizon.",
    "RMSE 80: within 80 degrees, weighted by both cosines.",
    "negative: predicted values below 0, before they are cut; measured files have some, which combinations inherit.",
    "recip., albedo: the worst material's relative difference of f(wi, wo) and f(wo, wi), and largest albedo.",
    f"ball ITP: Delta E_ITP of the ball (ITU-R BT.2124), mean of {LIGHTS}, display white 100 cd/m2, median.",
)

_COLOUR_NOTE = (
    "dE: CIEDE2000 of the radiance factor pi f in this light.",
    "angle: spectral angle in degrees between the spectra of the reflected light.",
    "Means over six directions of a multi-angle instrument (light at 45 degrees; aspecular -15, 15, 25, 45, 75, 110); "
    "medians over materials.",
)

_COSTS: Columns = (
    ("numbers", lambda m: str(m.numbers)),
    ("MB kept", lambda m: f"{m.bytes / 1e6:.1f}"),
    ("fit s", lambda m: f"{m.fit_seconds:.3f}"),
    ("locate ms", lambda m: f"{1e3 * m.encode_seconds:.1f}"),
    ("predict ms", lambda m: f"{1e3 * m.predict_seconds:.0f}"),
)
_COST_NOTE = (
    "numbers: per material.",
    "MB kept: numbers and measured values that predictions need, of all materials.",
    "Wall-clock times: of one fit, of locating one material, and of predicting it in all directions in which errors "
    "are measured.",
)

_CALIBRATION: Columns = (
    ("rms z", lambda m: f"{m.rms_standardised_error:.2f}"),
    ("median z", lambda m: f"{np.median(m.standardised_error or 0.0):.2f}"),
    ("calibrated", lambda m: _calibrated(m.rms_standardised_error or 0.0)),
)
_CALIBRATION_NOTE = (
    "z: error of the mapped values over the standard deviation that the method predicts.",
    f"calibrated: root mean square of z from {_LOWEST_RMS} to {_HIGHEST_RMS:g}.",
)

_EXPECTED_NAMES = {
    "ball": "ball", "cube_root": "cube root",
    "blended_ball": "ball, blended", "blended_cube_root": "cube root, blended",
}  # fmt: skip
_EXPECTED_NOTE = (
    "Each material is left out of the map; the latents of the others are kept. Its expected errors are computed "
    "without it, in its own colours or in colours blended from the surrounding materials.",
    f"ball: {BALL}.",
    "rank corr.: rank correlation of expected and true errors.",
    "below 2x: share of true errors below twice the expected.",
)


def lead(report: Report) -> str:
    """Return sentences about the errors of left-out materials, and about predictions between similar materials.

    They state the model's own error, the errors of baselines, whether the expected errors are right, and the detour.
    """
    by_key = {m.key: m for m in report.methods}
    own = next(by_key[key] for key in _OWN_METHODS if key in by_key)
    nearest, linear = by_key["nearest"], by_key["linear"]
    how = "a map fitted to the others" if "refitted" in own.key else "the map, whose latents stay as they are"
    expected = report.expected_errors and report.expected_errors["ball"]
    last = (
        "The model is not calibrated: it has no expected errors."
        if not expected
        else f"For {percent(expected.below_twice)} of the materials the ball error is below twice the expected one."
    )
    coherence = report.coherence.get(THIS_MODEL)
    between = (
        ""
        if coherence is None
        else f" Halfway between the most similar materials, the detour is {coherence.detour:.2f} in the median and "
        f"{coherence.detour_p90:.2f} at the 90th percentile; at 1, a prediction lies between the two."
    )
    return (
        f"Each material was left out and located from its own values on {how}. The prediction there "
        f"differs from the measurement by {own.median.ball:.1f} {BALL} in the median and {own.p90.ball:.1f} at the "
        f"90th percentile. The most similar other material differs by {nearest.median.ball:.1f} in the median, a "
        f"linear mix of the two nearest by {linear.median.ball:.1f}. {last}{between}"
    )


def format_summary(report: Report) -> str:
    """Format the errors of left-out materials by all methods, and the expected errors, as plain text."""
    methods = [m for m in _in_order(report.methods) if m.is_held_out]
    lines = [*_opening(report), *_section(methods, _ERRORS, (*_legend(methods), *_ERROR_NOTE))]
    lines += _expected_errors(report)
    return (
        "\n".join(
            [
                *lines,
                "`manifold report --full` also prints lights, colours, plausibility, materials.",
            ]
        )
        + "\n"
    )


def _opening(report: Report) -> list[str]:
    return [*_heading(report), "", *textwrap.wrap(lead(report), _WIDTH, break_on_hyphens=False), ""]


def format_report(report: Report) -> str:
    """Format short tables of all methods, then the materials, then times, as plain text that ends in a newline."""
    methods = _in_order(report.methods)
    illuminants = list(methods[0].errors.colours)
    colours: Columns = (
        *((f"dE {name}", lambda m, name=name: f"{m.median.colours[name]:.2f}") for name in illuminants),
        *((f"angle {name}", lambda m, name=name: f"{m.median.angles_deg[name]:.2f}") for name in illuminants),
    )
    calibrated = [m for m in methods if m.rms_standardised_error is not None]  # blends have no variance
    lines = [
        *_opening(report),
        *_section(methods, _ERRORS, (*_legend(methods), *_ERROR_NOTE)),
        *_section(methods, _LIGHTS, _LIGHTS_NOTE),
        *_section(methods, _PLAUSIBILITY, (*_PLAUSIBILITY_NOTE, *_uncertainty(report))),
        *_section(methods, colours, _COLOUR_NOTE),
        *_section(methods, _COSTS, _COST_NOTE),
        *(_section(calibrated, _CALIBRATION, _CALIBRATION_NOTE) if calibrated else []),
        *_expected_errors(report),
        *_coherence(report),
        *_materials(report),
        *_closing(report),
    ]
    return "\n".join(lines) + "\n"


def _uncertainty(report: Report) -> list[str]:
    """Return a sentence on how well the measured bands determine the RMSE of all bands."""
    if report.n_error_bands == report.n_bands:
        return []
    most = max(m.rmse_uncertainty for m in report.methods)
    return [
        f"Both RMSE are estimated from {report.n_error_bands} of {report.n_bands} bands, with an error of up to about "
        f"{percent(most)}; --all-bands computes them."
    ]


def _in_order(methods: Sequence[MethodResult]) -> list[MethodResult]:
    """Return the methods with all principal components one below the other."""
    components = [m for m in methods if m.key.startswith(_PCA)]
    others = [m for m in methods if not m.key.startswith(_PCA)]
    at = max((others.index(m) for m in others if m.key in _BEFORE_PCA), default=len(others) - 1) + 1
    return others[:at] + components + others[at:]


def _legend(methods: Sequence[MethodResult]) -> list[str]:
    """Return explanations of the methods that have a row; all others are fitted to the other materials."""
    lines = dict.fromkeys(_LEGEND[m.key] for m in methods if m.key in _LEGEND)
    return [*lines, "All other methods are fitted without the left-out material."]


def _section(methods: Sequence[MethodResult], columns: Columns, note: Sequence[str]) -> list[str]:
    """Return a section with a row per method."""
    rows = [(m.title, *(show(m) for _, show in columns)) for m in methods]
    return _table(("method", *(head for head, _ in columns)), rows, note)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], note: Sequence[str]) -> list[str]:
    """Return a table, the first column to the left and the others to the right, and its explanation."""
    head, *body = table_lines(columns, rows, numeric=[k > 0 for k in range(len(columns))])
    lines = [
        line for words in note
        for line in textwrap.wrap(words, _WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    ]  # fmt: skip
    return [head, "-" * len(head), *body, "", *lines, ""]


def _calibrated(rms: float) -> str:
    return "overconfident" if rms > _HIGHEST_RMS else "underconfident" if rms < _LOWEST_RMS else "yes"


def _heading(report: Report) -> list[str]:
    """Return the lines that name the evaluated materials and settings."""
    synthetic = sum(report.is_synthetic)
    some = f" ({synthetic} of them synthetic)" if synthetic else ""
    kind = " (synthetic corpus)" if synthetic == len(report.names) else some
    in_bands = "" if report.n_error_bands == report.n_bands else f", in {report.n_error_bands} bands"
    s = report.settings
    dimensions = counted(s["latent_dim"], "dimension")
    process = []  # blends have no Gaussian process
    if s["kind"] == "gplvm":
        process = [
            f"Kernel: {s['kernel']} + delta, mu {s['mu']:g}, length scale {s['length_scale']:g}, "
            f"condition of K {report.condition:.3g}"
        ]
    return [
        f"{len(report.names)} materials{kind}, {report.bands}",
        *textwrap.wrap(f"{_KINDS[s['kind']].format(dimensions)}; mapping {s['mapping']}", _WIDTH),
        *process,
        f"Errors over {report.n_pairs:,} direction pairs (grid '{report.grid}'){in_bands}",
    ]


def _fixed(error: float) -> str:
    """Format a relative error with three decimals, or as a power of ten if it is huge, as for a black material."""
    return f"{error:.3f}" if error < _MANY_DIGITS else f"{error:.0e}"


def _expected_errors(report: Report) -> list[str]:
    """Return the calibration of the expected errors as lines."""
    if report.expected_errors is None:
        return [*textwrap.wrap(f"Expected errors: {'; '.join(NOT_CALIBRATED)}.", _WIDTH), ""]
    rows = [
        (
            _EXPECTED_NAMES[name],
            *(f"{value:.{2 if name.endswith('ball') else 3}f}" for value in (*c.true, *c.expected)),
            f"{c.rank_correlation:.2f}",
            percent(c.below_twice),
            "-" if c.bound is None else f"{c.bound:.1f}",
        )
        for name, c in report.expected_errors.items()
    ]
    columns = ("expected errors", "true", "p90", "expected", "p90", "rank corr.", "below 2x", "bound")
    most = next(iter(report.expected_errors.values())).most_level
    bound = (
        f"bound: {percent(LEVEL)} of the left-out errors are below this factor times the expected error; for new "
        f"materials drawn like these that is an estimate, not a guarantee. This many materials allow levels up to "
        f"{percent(most)}."
    )
    return _table(columns, rows, (*_EXPECTED_NOTE, bound))


def _coherence(report: Report) -> list[str]:
    """Return the coherence of the maps as lines."""
    rows = [
        (title, f"{c.detour:.2f}", f"{c.detour_p90:.2f}", percent(c.detour_far), percent(c.neighbours_kept))
        for title, c in report.coherence.items()
    ]
    columns = ("between materials", "detour", "p90", f"above {FAR}", "neighbours kept")
    note = (
        "detour: of the prediction halfway between a material and the one that looks most like it, the CIEDE2000 from "
        f"both over that between both; 1 lies between them. Balls are compared in the {LIGHTS}, in blended colours.",
        f"neighbours kept: share of the {NEIGHBOURS_COMPARED} most similar materials that are among the "
        f"{NEIGHBOURS_COMPARED} nearest on the map.",
    )
    return _table(columns, rows, note) if rows else []


def _materials(report: Report) -> list[str]:
    """Return one row per material: latent, and left-out errors."""
    by_key = {m.key: m for m in report.methods}
    shown = [key for key in _MATERIAL_COLUMNS if key in by_key][:_SHOWN_METHODS]
    first = by_key[shown[0]]
    head = ("material", "latent", "CIEDE2000", *(_MATERIAL_COLUMNS[key] for key in shown))
    rows = [
        (
            name,
            _latent(report.latents[k]),
            f"{first.errors.ball[k]:.2f}",
            *(_fixed(by_key[key].errors.linear[k]) for key in shown),
        )
        for k, name in enumerate(report.names)
    ]
    note = (
        f"CIEDE2000: of the ball, mean of {LIGHTS}, by '{first.title}'.",
        f"The other columns are linear errors; '{_MATERIAL_COLUMNS[shown[0]]}' is the same method.",
    )
    return _table(head, rows, note)


def _closing(report: Report) -> list[str]:
    """Return lines on times and on methods that were not run."""
    s = report.seconds
    lines = textwrap.wrap(
        f"Loading {s['load']:.1f} s, tabulating {s['tabulate']:.1f} s, fitting and locating "
        f"{s['encode']:.1f} s, evaluating {s['evaluate']:.1f} s.",
        _WIDTH,
    )
    if report.left_out:
        lines.append(f"Not run, because they take long: {len(report.left_out)} more methods (--compare).")
    return lines


def _latent(x: Sequence[float]) -> str:
    """Format the first coordinates; the JSON report holds all of them."""
    return ", ".join(
        [*(f"{v:+.2f}" for v in x[:_SHOWN_COORDINATES]), *(["..."] if x[_SHOWN_COORDINATES:] else [])]
    )
