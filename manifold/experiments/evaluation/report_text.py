"""A report as text for people, at most 80 columns wide."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.experiments.evaluation.report import MethodResult, Report

_SHOWN_COORDINATES = 2  # of a latent, so that a row fits 80 columns
# Methods whose errors every material shows: column title per key, most honest first, as many as fit.
_MATERIAL_COLUMNS = {
    "blend_refitted": "refitted",
    "gp_refitted": "refitted",
    "gp_encoded": "encoded",
    "gp_latents_kept": "kept",
    "linear": "linear",
    "nearest": "nearest",
}
_SHOWN_METHODS = 4
_LOWEST_RMS, _HIGHEST_RMS = 0.5, 2.0  # of standardised errors, within which a method counts as calibrated
_MANY_DIGITS = 1e5


_KINDS = {
    "blend": "Blends of materials: {}, and two colours per band",
    "material": "GPLVM of whole materials: {}",
    "monochrome": "GPLVM of single bands: {}, and a colour per band",
}


def format_report(report: Report) -> str:
    """Short tables of all methods, then the materials, then times; plain text that ends in a newline."""
    lines = [
        *_heading(report),
        "",
        *_errors(report.methods),
        "",
        *_plausibility(report.methods),
        "",
        *_colours(report.methods),
        "",
        *_costs(report.methods),
        "",
        *_calibration(report.methods),
        *_expected_errors(report),
        "",
        *_materials(report),
        "",
        *_closing(report),
    ]
    return "\n".join(lines) + "\n"


def _heading(report: Report) -> list[str]:
    """What was evaluated."""
    synthetic = sum(report.is_synthetic)
    kind = ""
    if synthetic:
        kind = (
            " (synthetic corpus)" if synthetic == len(report.names) else f" ({synthetic} of them synthetic)"
        )
    s = report.settings
    dimensions = f"{s['latent_dim']} dimension{'s' * (s['latent_dim'] != 1)}"
    return [
        f"{len(report.names)} materials{kind}, {report.bands}",
        f"{_KINDS[s['kind']].format(dimensions)}; mapping {s['mapping']}",
        f"Kernel: {s['kernel']} + delta, mu {s['mu']:g}, length scale {s['length_scale']:g}, "
        f"condition of K {report.condition:.3g}",
        f"Errors over {report.n_pairs:,} direction pairs (grid '{report.grid}'){_error_bands(report)}",
    ]


def _error_bands(report: Report) -> str:
    total = 3 if report.bands == "RGB" else int(report.bands.split()[0])
    return "" if report.n_error_bands == total else f", in {report.n_error_bands} bands"


def _errors(methods: Sequence[MethodResult]) -> list[str]:
    head = ("method", "linear", "p90", "cube root", "p90", "ball dE", "p90")
    rows = [
        (
            m.title,
            _fixed(m.median_relative_error),
            _fixed(m.p90_relative_error),
            _fixed(m.median_cube_root_error),
            _fixed(m.p90_cube_root_error),
            f"{m.median_ball_delta_e:.2f}",
            f"{m.p90_ball_delta_e:.2f}",
        )
        for m in methods
    ]
    return [
        *_table(head, rows),
        "",
        "Reconstructions use the material they predict; the mix of two uses it to choose",
        "the two. Latents kept, or others kept: latents fitted with the material, which",
        "is then predicted without it. All other methods are fitted without the material.",
        "a + b per band: a coordinates that all bands share, and b of every band.",
        "Medians and 90th percentiles of materials. linear: relative, cosine-weighted,",
        "dominated by highlights; cube root: the same of cube roots, closer to perceived",
        "differences; ball dE: mean CIEDE2000 of a ball in a studio, D65.",
    ]


def _fixed(error: float) -> str:
    """A relative error with three decimals; that of a black material, over nothing, as a power of ten."""
    return f"{error:.3f}" if error < _MANY_DIGITS else f"{error:.0e}"


def _plausibility(methods: Sequence[MethodResult]) -> list[str]:
    head = ("values", "RMSE", "negative", "reciprocity", "albedo", "ball ITP")
    rows = [
        (
            m.title,
            f"{np.nanmedian(m.rmse):.3g}",
            f"{m.negative_share:.2%}",
            f"{m.reciprocity_error:.3f}",
            f"{m.max_albedo:.2f}",
            f"{m.median_ball_delta_e_itp:.1f}",
        )
        for m in methods
    ]
    return [
        *_table(head, rows),
        "",
        "RMSE: Hikichi & Iwasaki, eq. 22, median, 1/sr. negative: share of values;",
        "measured files have some too. reciprocity, albedo: error and largest value of",
        "the worst material. ball ITP: mean Delta E_ITP of the ball (ITU-R BT.2124) on a",
        "display whose white has 100 cd/m2, median.",
    ]


def _colours(methods: Sequence[MethodResult]) -> list[str]:
    head = (
        "colour",
        *(f"dE {c.illuminant}" for c in methods[0].colour),
        *(f"<) {c.illuminant}" for c in methods[0].colour),
    )
    rows = [
        (
            m.title,
            *(f"{c.median_delta_e:.2f}" for c in m.colour),
            *(f"{c.median_spectral_angle_deg:.2f}" for c in m.colour),
        )
        for m in methods
    ]
    return [
        *_table(head, rows),
        "",
        "dE: CIEDE2000 of the radiance factor pi f. <): angle in degrees between the",
        "spectra of the reflected light. Means over six directions of a multi-angle",
        "instrument (light at 45 degrees; aspecular -15, 15, 25, 45, 75, 110); medians",
        "of materials.",
    ]


def _costs(methods: Sequence[MethodResult]) -> list[str]:
    head = ("cost", "numbers", "MB kept", "fit s", "encode ms", "predict ms")
    rows = [
        (
            m.title,
            str(m.numbers),
            f"{m.bytes / 1e6:.1f}",
            f"{m.fit_seconds:.3f}",
            f"{1e3 * m.encode_seconds:.1f}",
            f"{1e3 * m.predict_seconds:.0f}",
        )
        for m in methods
    ]
    return [
        *_table(head, rows),
        "",
        "numbers: per material. MB kept: numbers and measured values that predictions",
        "need, of all materials. Wall-clock times: of one fit, of encoding one material,",
        "and of predicting it wherever errors are measured.",
    ]


def _calibration(methods: Sequence[MethodResult]) -> list[str]:
    """Of methods that expect errors of their own; blends have none."""
    known = [m for m in methods if m.rms_standardised_error is not None and m.standardised_error is not None]
    if not known:
        return []
    rows = []
    for m in known:
        rms = m.rms_standardised_error or 0.0
        verdict = "too sure" if rms > _HIGHEST_RMS else "too unsure" if rms < _LOWEST_RMS else "yes"
        rows.append((m.title, f"{rms:.2f}", f"{np.median(m.standardised_error or 0.0):.2f}", verdict))
    return [
        *_table(("calibration", "rms z", "median z", "calibrated"), rows),
        "",
        "z: error of the mapped values in the standard deviations the method expected;",
        f"calibrated: root mean square from {_LOWEST_RMS} to {_HIGHEST_RMS:g}.",
        "",
    ]


def _expected_errors(report: Report) -> list[str]:
    """Calibration of the expected errors."""
    if report.expected_errors is None:
        return ["No expected errors: not calibrated; embed again, with four materials or more."]
    digits = {"ball": 2, "cube_root": 3}
    rows = [
        (
            name.replace("_", " "),
            *(f"{value:.{digits[name]}f}" for value in (c.true[0], c.true[1], c.expected[0], c.expected[1])),
            f"{c.rank_correlation:.2f}",
            f"{c.below_twice:.0%}",
        )
        for name, c in report.expected_errors.items()
    ]
    return [
        *_table(("expected errors", "true", "p90", "expected", "p90", "rank corr.", "below 2x"), rows),
        "",
        "Of materials left out of the map, the others kept where they are, and errors",
        "expected without them; rank corr.: of expected with true errors; below 2x: true",
        "errors that are below twice the expected.",
    ]


def _materials(report: Report) -> list[str]:
    """One row per material: latent, and held-out errors."""
    by_key = {m.key: m for m in report.methods}
    shown = [key for key in _MATERIAL_COLUMNS if key in by_key][:_SHOWN_METHODS]
    first = by_key[shown[0]]
    head = ("material", "latent", "ball dE", *(_MATERIAL_COLUMNS[key] for key in shown))
    rows = [
        (
            name,
            _latent(report.latents[k]),
            f"{first.ball_delta_e[k]:.2f}",
            *(_fixed(by_key[key].relative_error[k]) for key in shown),
        )
        for k, name in enumerate(report.names)
    ]
    return [
        *_table(head, rows),
        "",
        f"ball dE: of '{first.title}'.",
        f"To its right: linear errors, first of the same method ({_MATERIAL_COLUMNS[shown[0]]}).",
    ]


def _closing(report: Report) -> list[str]:
    """Times, and what was not run."""
    s = report.seconds
    lines = [
        f"Loading {s['load']:.1f} s, tabulating {s['tabulate']:.1f} s, fitting and encoding "
        f"{s['encode']:.1f} s, evaluating {s['evaluate']:.1f} s."
    ]
    if report.left_out:
        lines.append(f"{len(report.left_out)} more methods take long: --compare runs them too.")
    return lines


def _latent(x: Sequence[float]) -> str:
    """The first coordinates; the JSON report holds them all."""
    return ", ".join(
        [*(f"{v:+.2f}" for v in x[:_SHOWN_COORDINATES]), *(["..."] if x[_SHOWN_COORDINATES:] else [])]
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Aligned lines: the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]

    def line(row: Sequence[str]) -> str:
        first, *rest = (
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        return "  ".join([first, *rest]).rstrip()

    return [line(head), "-" * len(line(head)), *(line(row) for row in rows)]
