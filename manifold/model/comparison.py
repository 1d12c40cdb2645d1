"""The errors of reports between two BRDFs of any kind."""

from __future__ import annotations

from manifold.brdf.measured import BRDF, all_isotropic, require_brdf
from manifold.colour import panel
from manifold.metrics import Errors
from manifold.pairs import RusinkiewiczGrid


def brdf_errors(brdf: BRDF, predicted: BRDF) -> Errors[float]:
    """Return the errors of reports, on the direction pairs of their default grid and in all bands.

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
    return lights.errors(lit, lit_star, brdf.bands) | Errors.of_values(f, f_star, pairs.cosines)
