"""The errors of reports between any two BRDFs."""

from __future__ import annotations

from typing import Any, NamedTuple

from manifold.brdf.measured import BRDF, all_isotropic, require_brdf
from manifold.colour import panel
from manifold.colour.panel import LookErrors
from manifold.metrics import cube_root_error, relative_error
from manifold.pairs import RusinkiewiczGrid


class BRDFErrors(NamedTuple):
    """Errors of one BRDF with respect to another.

    Attributes:
        ball: CIEDE2000 of the ball, mean over the lights of `panel.JUDGED`.
        cube_root: relative error of cube roots, `||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`.
        linear: relative error, `||w (f* - f)|| / ||w f||`.
        look: of the ball, by light.
    """

    ball: float
    cube_root: float
    linear: float
    look: LookErrors

    @property
    def words(self) -> list[str]:
        """For a terminal."""
        look = self.look
        return [
            f"{self.ball:.1f} CIEDE2000 of the ball in the mean of {len(look.lights)} lights",
            f"{look.worst:.1f} in the worst of them, {look.worst_light}",
            f"{self.cube_root:.0%} cube-root error",
            f"{self.linear:.0%} linear",
        ]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"relative_error": self.linear, "cube_root_error": self.cube_root} | self.look.to_json()


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
    pairs, lights = grid.pairs(), panel.judged()
    f, f_star = (each.eval(pairs.wi, pairs.wo) for each in (brdf, predicted))
    lit, lit_star = (each.eval(lights.wi, lights.wo) for each in (brdf, predicted))
    look = lights.errors(lit, lit_star, brdf.bands)
    return BRDFErrors(
        look.ball, cube_root_error(f, f_star, pairs.cosines), relative_error(f, f_star, pairs.cosines), look
    )
