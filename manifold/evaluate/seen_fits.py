"""Fits to the evaluated material itself, beside held-out predictions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from manifold.brdf.measured import EvaluableBRDF
from manifold.evaluate.cross_validation import Encode, Method
from manifold.evaluate.tabulated import Data
from manifold.fit.principled import fit_bsdf
from manifold.mapping import Identity
from manifold.model.combination import Combination, Values
from manifold.records import Array, Indices
from manifold.render import fit_json
from manifold.render.fitted_brdf import FittedBRDF


@dataclass(frozen=True, eq=False)
class FittedPrediction(Combination):
    """A prediction that is a BRDF of its own, and no combination of measured materials.

    Attributes:
        brdf: in all bands; None where there is no fit, and every value is NaN.
        bands: which of its bands, shape (B,).
    """

    brdf: EvaluableBRDF | None = field(kw_only=True)
    bands: Indices = field(kw_only=True)

    @classmethod
    def of(cls, brdf: EvaluableBRDF | None, n_bands: int) -> FittedPrediction:
        """All bands of a BRDF."""
        bands = np.arange(n_bands)
        return cls(Identity(), np.zeros((n_bands, 0)), bands[:0], is_clipped=False, brdf=brdf, bands=bands)

    def in_bands(self, bands: Indices) -> FittedPrediction:
        """The same in some bands (B',)."""
        return replace(self, bands=self.bands[bands])

    def mapped(self, values: Values) -> Array:
        """f in 1/sr, shape (P, B)."""
        if self.brdf is None:
            return np.full((len(values.wi), len(self.bands)), np.nan)
        return self.brdf.eval(values.wi, values.wo)[:, self.bands]


def seen_principled() -> Method:
    """Fits of Mitsuba's principled to the seen materials, as a method."""

    def fit_principled(data: Data, training: Indices) -> Encode:
        def encode(i: int) -> Combination:
            material = data.materials[i]
            content = fit_json.document(fit_bsdf(material), fit_json.Source(material.name))
            return FittedPrediction.of(FittedBRDF(content), data.n_bands)

        return encode

    return Method(
        "principled",
        "principled, fitted to it",
        lambda B: B + 6,
        fit_principled,
        is_held_out=False,
        refits=False,
    )
