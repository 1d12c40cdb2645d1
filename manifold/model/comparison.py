"""The errors of reports between any two BRDFs."""

from __future__ import annotations

from typing import NamedTuple

from manifold.brdf.measured import BRDF, all_isotropic, require_brdf
from manifold.colour import ball_colours
from manifold.encoding import EncodingPairs
from manifold.metrics import RusinkiewiczGrid, cube_root_error, relative_error


class BRDFErrors(NamedTuple):
    """Errors of one BRDF with respect to another.

    Attributes:
        ball: mean CIEDE2000 of the ball.
        cube_root: relative error of cube roots, `||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`.
        linear: relative error, `||w (f* - f)|| / ||w f||`.
    """

    ball: float
    cube_root: float
    linear: float


def brdf_errors(brdf: BRDF, predicted: BRDF) -> BRDFErrors:
    """The three errors of reports, on the direction pairs of their default grid and in all bands.

    Where one of both is anisotropic, the pairs have all azimuths.

    Args:
        brdf: the measured or true BRDF f.
        predicted: the BRDF f* that describes it, in the same bands.
    Raises:
        UsageError: one of them lacks the methods of `manifold.brdf.BRDF`.
        BandMismatchError: they have different bands.
    """
    require_brdf(brdf, "the true BRDF")
    require_brdf(predicted, "the prediction")
    brdf.bands.require_same(predicted.bands, "the prediction", "resample it")
    grid = RusinkiewiczGrid.named("default").suited_to(all_isotropic([brdf, predicted]))
    pairs, ball = EncodingPairs.of_grid(grid, stride=1), ball_colours.ball()
    f, f_star = (each.eval(pairs.wi, pairs.wo) for each in (brdf, predicted))
    lit, lit_star = (each.eval(ball.wi, ball.wo) for each in (brdf, predicted))
    return BRDFErrors(
        float(ball.difference(lit, lit_star, brdf.bands)),
        cube_root_error(f, f_star, pairs.cosines),
        relative_error(f, f_star, pairs.cosines),
    )
