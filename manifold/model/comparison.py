"""Computes the errors that reports show, between any two BRDFs."""

from __future__ import annotations

import numpy as np

from manifold.brdf.interface import BRDF, all_isotropic, require_brdf
from manifold.brdf.measured import values_at
from manifold.colour import panel
from manifold.core.metrics import Errors
from manifold.core.pairs import Pairs, RusinkiewiczGrid

_BLOCK_VALUES = 2_000_000  # values of a BRDF held at once


def rmse22(brdf: BRDF, predicted: BRDF, grid: str = "hikichi") -> float:
    """Return eq. 22 of Hikichi & Iwasaki between two BRDFs, in 1/sr; bands are summed.

    Values are compared at 90 x 90 x 180 directions of a Rusinkiewicz grid, without weights.

    Args:
        brdf: the measured or true BRDF.
        predicted: the predicted or fitted BRDF, in the same bands.
        grid: name of the grid; `default` is coarser, but denser around the mirror direction.

    Raises:
        UsageError: an argument lacks the methods of `manifold.brdf.BRDF`, or there is no such grid.
        BandMismatchError: the BRDFs have different bands.
    """
    require_both(brdf, predicted)
    nodes = RusinkiewiczGrid.named(grid).suited_to(all_isotropic([brdf, predicted]))
    squared = 0.0
    for wi, wo, above in nodes.blocks():
        pairs = Pairs(wi[above], wo[above])
        for _, some in pairs.blocks(_BLOCK_VALUES // brdf.bands.count):
            squared += float(np.sum((values_at(brdf, some) - values_at(predicted, some)) ** 2))
    return float(np.sqrt(squared / nodes.n_pairs))


def require_both(brdf: BRDF, predicted: BRDF) -> None:
    """Raise UsageError or BandMismatchError unless both arguments are BRDFs with the same bands."""
    require_brdf(brdf, "the true BRDF")
    require_brdf(predicted, "the prediction")
    brdf.bands.require_same(predicted.bands, "the prediction")


def brdf_errors(brdf: BRDF, predicted: BRDF) -> Errors[float]:
    """Return the errors of a predicted BRDF that reports show, on the default grid of direction pairs and in all bands.

    If one of the BRDFs is anisotropic, the grid covers all azimuths.

    Args:
        brdf: the measured or true BRDF f.
        predicted: the predicted or fitted BRDF f*, in the same bands.

    Raises:
        UsageError: an argument lacks the methods of `manifold.brdf.BRDF`.
        BandMismatchError: the BRDFs have different bands.
    """
    require_both(brdf, predicted)
    grid = RusinkiewiczGrid.named("default").suited_to(all_isotropic([brdf, predicted]))
    pairs, lights = grid.pairs(), panel.judged()
    f, f_star = (each.eval(pairs.wi, pairs.wo) for each in (brdf, predicted))
    lit, lit_star = (each.eval(lights.wi, lights.wo) for each in (brdf, predicted))
    return lights.errors(lit, lit_star, brdf.bands) | Errors.of_values(f, f_star, pairs.cosines)
