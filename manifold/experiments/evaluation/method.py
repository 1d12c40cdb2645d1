"""The interface of a held-out method: fitted to some materials, it encodes others as weighted sums of these."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from manifold.experiments.evaluation.tabulated import Data
from manifold.model.combination import Combination
from manifold.records import Array

Encode = Callable[[int], Combination]
"""From the index of a material to its prediction."""

Fit = Callable[[Data, Array], Encode]
"""From data and the indices of the materials to learn from to what encodes any material."""


@dataclass(frozen=True)
class Method:
    """A way to predict materials.

    Attributes:
        key: name in JSON.
        title: for people.
        numbers: how many numbers describe a material of B bands.
        fit: learns from some materials, and encodes any.
        is_held_out: whether the prediction of a material is made from the others only.
        refits: whether every left-out material needs a fit without it; False: one fit to all serves, and
            `fit` keeps the held-out promise itself.
        sample_bands: bands of the measured files that predictions need, at most; None is all.
        fits_model: whether a fit searches for latents, which takes long.
    """

    key: str
    title: str
    numbers: Callable[[int], int]
    fit: Fit
    is_held_out: bool = True
    refits: bool = True
    sample_bands: int | None = None
    fits_model: bool = False
