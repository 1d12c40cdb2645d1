"""What speaks against a result, in sentences for a user; an empty tuple where nothing does."""

from __future__ import annotations

from manifold.brdf.plausibility import Plausibility

MOST_NEGATIVE = 0.005  # share of values, above which a prediction carries a caution; one in a hundred is seen
MOST_ALBEDO = 1.05  # measured materials reach a little above 1 too
MOST_NON_RECIPROCAL = 0.5  # relative; measured materials reach 0.3, mirrors more
MOST_MISSED = 0.02  # of a reflectance
MOST_UNMEASURED = 0.01  # of the cells that should hold something
_BRIGHTER = 1.1  # of a file against what it was written from; elsewhere interpolation errs by a few per cent
MOST_EMBEDDING_ERROR = 0.5  # relative: half of the material is not given back


def of_prediction(is_extrapolation: bool, found: Plausibility, missed: float = 0.0) -> tuple[str, ...]:
    """Of a prediction.

    Args:
        is_extrapolation: whether the data say little there.
        found: what was measured on it.
        missed: largest distance over bands of the reflectance asked for from the one reached.
    """
    cautions = []
    if is_extrapolation:
        cautions.append("extrapolated: the data say little here; stay nearer to the materials")
    if found.negative_share > MOST_NEGATIVE:
        cautions.append(
            f"{100.0 * found.negative_share:.2g}% of the values were negative: the data do not support this point"
        )
    if found.max_albedo > MOST_ALBEDO:
        cautions.append(
            f"returns up to {found.max_albedo:.2f} times the light it gets; --physical scales it down"
        )
    if found.reciprocity_error > MOST_NON_RECIPROCAL:
        cautions.append(
            f"differs by {found.reciprocity_error:.0%} when light and eye change places; --physical mends that"
        )
    if missed > MOST_MISSED:
        cautions.append(f"this structure misses the reflectance asked for by up to {missed:.2f}")
    return tuple(cautions)


def of_file(predicted_albedo: float, file_albedo: float) -> tuple[str, ...]:
    """Of a written prediction, by its largest albedo beside that of what it was written from."""
    if file_albedo <= max(MOST_ALBEDO, _BRIGHTER * predicted_albedo):
        return ()
    return (
        f"its file returns up to {file_albedo:.2f} times the light it gets, the prediction itself "
        f"{predicted_albedo:.2f}: write more --incidences, or render it with --direct",
    )


def of_unmeasured(share: float) -> tuple[str, ...]:
    """Of values that were not measured, as a share of the cells that should hold something."""
    if share <= MOST_UNMEASURED:
        return ()
    return (
        f"{share:.0%} of the cells were not measured and are filled from their neighbours; see `manifold info`",
    )


def of_embedding(relative_error: float) -> tuple[str, ...]:
    """Of a material that was given a latent, by the error of what the manifold gives back there."""
    if relative_error <= MOST_EMBEDDING_ERROR:
        return ()
    return (
        f"the manifold gives this material back with an error of {relative_error:.2f}: it has no place here; "
        "import materials like it and embed again",
    )
