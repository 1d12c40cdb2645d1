"""A report as text for people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from manifold.heldout import Result
from manifold.report import MethodResult, Report

_SHOWN_COORDINATES = 2  # of a latent, so that a row fits 80 columns
_SHORT_TITLES = {
    "gp_refitted": "refitted",
    "gp_latents_kept": "kept",
}  # of columns; the others' keys are short


def format_report(report: Report) -> str:
    """Summary of the methods, then the materials, then times; plain text that ends in a newline."""
    synthetic = sum(report.is_synthetic)
    kind = ""
    if synthetic:
        kind = (
            " (synthetic corpus)" if synthetic == len(report.names) else f" ({synthetic} of them synthetic)"
        )
    s = report.settings
    lines = [
        f"{len(report.names)} materials{kind}, {report.bands}",
        f"GPLVM: {s['latent_dim']} dimensions, mapping {s['mapping']}",
        f"Kernel: SE + delta, mu {s['mu']:g}, length scale {s['length_scale']:g}, "
        f"condition of K {report.condition:.3g}",
        f"{report.n_pairs:,} direction pairs (grid '{report.grid}')",
        "",
        *_table(
            ("method", "error", "p90", "RMSE", "negative", "recip.", "albedo", "fit s"),
            [_method_row(m) for m in report.methods],
        ),
        "",
        "Reconstruction sees the material it predicts; all other methods do not.",
        "error, p90: relative, cosine-weighted; median and 90th percentile of materials.",
        "RMSE: eq. 22, median, 1/sr. negative: share of values. recip., albedo: worst.",
        "",
        *_material_table(report),
        "",
        f"Loading {report.seconds['load']:.1f} s, evaluating {report.seconds['evaluate']:.1f} s.",
    ]
    return "\n".join(lines) + "\n"


def format_comparison(results: Sequence[Result]) -> str:
    """Encode-decode leave-one-out of several methods; plain text that ends in a newline."""
    rows = [
        (
            r.title,
            str(r.numbers),
            f"{r.median:.3f}",
            f"{r.p90:.3f}",
            f"{r.negative_share:.2%}",
            f"{r.seconds:.1f}",
        )
        for r in results
    ]
    head = ("encode-decode leave-one-out", "numbers", "median", "90th pct.", "negative", "seconds")
    note = "Relative error of materials that a model was fitted without; numbers describe one material.\n"
    return "\n".join(_table(head, rows)) + "\n\n" + note


def _method_row(method: MethodResult) -> tuple[str, ...]:
    return (
        method.title,
        f"{method.median_relative_error:.3f}",
        f"{method.p90_relative_error:.3f}",
        f"{np.median(method.rmse):.3g}",
        f"{method.negative_share:.2%}",
        f"{method.reciprocity_error:.3f}",
        f"{method.max_albedo:.2f}",
        f"{method.seconds:.2f}",
    )


def _material_table(report: Report) -> list[str]:
    """One row per material: latent, reconstruction, and held-out relative errors."""
    reconstruction = next(m for m in report.methods if not m.is_held_out)
    held_out = [m for m in report.methods if m.is_held_out]
    head = ("material", "latent", "RMSE", *(_SHORT_TITLES.get(m.key, m.key) for m in held_out))
    rows = [
        (
            name,
            _latent(report.latents[k]),
            f"{reconstruction.rmse[k]:.3g}",
            *(f"{m.relative_error[k]:.3f}" for m in held_out),
        )
        for k, name in enumerate(report.names)
    ]
    note = "RMSE: of the reconstruction. To its right: relative errors of the other methods."
    return [*_table(head, rows), "", note]


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
