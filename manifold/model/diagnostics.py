"""Diagnostics of a result, in sentences for a user; an empty tuple where nothing speaks against it."""

from __future__ import annotations

from manifold.brdf.physical import RECIPROCITY_ERROR
from manifold.brdf.plausibility import Plausibility

MOST_NEGATIVE = 0.005  # share of values, above which a prediction is diagnosed; one in a hundred is seen
MOST_ALBEDO = 1.05  # measured materials reach a little above 1 too
MOST_NON_RECIPROCAL = 0.5  # relative; measured materials reach 0.3, mirrors more
MOST_MISSED = 0.02  # of a reflectance
MOST_UNMEASURED = 0.01  # of the cells that should hold something
MOST_EMBEDDING_ERROR = 0.5  # relative: half of the material is not reconstructed


def of_prediction(is_extrapolation: bool, found: Plausibility, missed: float = 0.0) -> tuple[str, ...]:
    """Of a prediction.

    Args:
        is_extrapolation: whether the data say little there.
        found: what was measured on it.
        missed: largest distance over bands of the reflectance asked for from the one reached.
    """
    diagnostics = []
    if is_extrapolation:
        diagnostics.append(
            "extrapolated: posterior variance over half of the prior's; stay nearer to the materials"
        )
    if found.negative_share > MOST_NEGATIVE:
        diagnostics.append(
            f"{100.0 * found.negative_share:.2g} % of the values were negative; the data do not support this point"
        )
    if found.max_albedo > MOST_ALBEDO:
        diagnostics.append(
            f"not energy-conserving: directional albedo {found.max_albedo:.2f}; --physical scales it to 1"
        )
    if found.reciprocity_error > MOST_NON_RECIPROCAL:
        diagnostics.append(
            f"not reciprocal: f(wi, wo) and f(wo, wi) differ by {100.0 * found.reciprocity_error:.0f} %; "
            "--physical takes their mean"
        )
    if missed > MOST_MISSED:
        diagnostics.append(
            f"requested reflectance out of reach at this structure: missed by up to {missed:.2f}"
        )
    return tuple(diagnostics)


def of_projection(found: Plausibility | None) -> tuple[str, ...]:
    """Of a file that was to be physical, by what was measured on it; of none, nothing."""
    if found is None or found.reciprocity_error <= RECIPROCITY_ERROR:
        return ()
    return (
        f"not reciprocal: the file's f(wi, wo) and f(wo, wi) still differ by {100.0 * found.reciprocity_error:.0f} %, "
        f"expected at most {100.0 * RECIPROCITY_ERROR:.0f} %; write more --resolution and --incidences",
    )


def of_unmeasured(share: float) -> tuple[str, ...]:
    """Of cells that were not measured, as a share of those that should hold something."""
    if share <= MOST_UNMEASURED:
        return ()
    return (
        f"{100.0 * share:.0f} % of the cells were not measured, but filled from neighbours; see `manifold info`",
    )


def of_embedding(relative_error: float) -> tuple[str, ...]:
    """Of a material that was given a latent, by its reconstruction error there."""
    if relative_error <= MOST_EMBEDDING_ERROR:
        return ()
    return (
        f"reconstruction error {relative_error:.2f}: outside the manifold; import materials like it and embed again",
    )
