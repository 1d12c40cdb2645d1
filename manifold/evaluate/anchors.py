"""Fits to the evaluated material itself, beside held-out predictions: Mitsuba's principled, neural fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from manifold.analytic.neural import NeuralBRDF, read_neural_fits
from manifold.brdf.measured import EvaluableBRDF
from manifold.errors import UsageError
from manifold.evaluate.cross_validation import Encode, Method
from manifold.evaluate.tabulated import Data
from manifold.fit.principled import fit_bsdf
from manifold.mapping import Identity
from manifold.model.combination import Combination, Values
from manifold.records import Array, Bands, Indices
from manifold.render import fit_json
from manifold.render.fitted_brdf import FittedBRDF

PRINCIPLED = "principled"
NEURAL_NUMBERS = 675  # weights and biases of the published networks


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


def anchor(name: str) -> Method:
    """Fits of the seen materials as a method.

    Args:
        name: `principled`, or a file, folder or zip file of the published neural fits; materials that these lack
            have no errors.
    Raises (when it is fitted):
        UsageError: there is no such source, or none of its fits is of one of the materials.
        FileFormatError: the source holds no neural fits, or damaged ones.
        RendererError: `principled` without Mitsuba.
    """

    def fit_principled(data: Data, training: Indices) -> Encode:
        def encode(i: int) -> Combination:
            material = data.materials[i]
            content = fit_json.document(fit_bsdf(material), fit_json.Source(material.name))
            return FittedPrediction.of(FittedBRDF(content), data.n_bands)

        return encode

    def read_neural(data: Data, training: Indices) -> Encode:
        fits = neural_fits(name, [material.name for material in data.materials], data.materials[0].bands)
        return lambda i: FittedPrediction.of(fits.get(i), data.n_bands)

    seen = partial(Method, is_held_out=False, refits=False)
    if name == PRINCIPLED:
        return seen(PRINCIPLED, "principled, fitted to it", lambda B: B + 6, fit_principled)
    return seen("neural", "neural fit of it", lambda B: NEURAL_NUMBERS, read_neural)


def neural_fits(source: str, names: Sequence[str], bands: Bands) -> dict[int, NeuralBRDF]:
    """Published neural fits of the materials that have one, by their index.

    Raises:
        UsageError: there is no such source, or none of its fits is of one of the materials.
        FileFormatError: the source holds no neural fits, or damaged ones.
    """
    fits = read_neural_fits(source, bands)
    found = {i: fits[name] for i, name in enumerate(names) if name in fits}
    if not found:
        known = ", ".join(sorted(fits)[:3])
        raise UsageError(f"{source}: no neural fit of any of {', '.join(names[:3])} ... (found {known} ...)")
    return found
