"""Compile what Numba compiles at first use, by a small job that uses all of it; from then on it is loaded.

Several processes that start at the same time would each compile for themselves.
"""

from __future__ import annotations

import warnings

import numpy as np

from manifold.analytic import corpus, fresnel
from manifold.brdf.goniometer import remeasure
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import profile_pairs, squared_valleys, valley_depth
from manifold.brdf.sums import WeightedSum
from manifold.gplvm import GPLVM
from manifold.library.compact import dequantise
from manifold.nonnegative import nonnegative_weights
from manifold.pairs import Pairs


def compile_rendering() -> None:
    """Measure a clear-coated and a metallic material, evaluate, sample and integrate one."""
    known = {material.name: material for material in corpus.isotropic_materials()}
    corpus.measure(known["syn_metal_copper"], rgb=True)
    file = corpus.measure(known["syn_gloss_red"], rgb=True)
    one = np.ones(1)
    fresnel.fresnel_thin_film(one, 500.0 * one, 1.4 * one, 100.0, one, one)
    measured = MeasuredBRDF(file)
    remeasure(measured, file)
    wi, wo = profile_pairs()
    valley_depth(np.moveaxis(measured.eval(wi, wo), -1, 0))
    wi = np.array(np.broadcast_to(wi, wo.shape))
    many = [np.repeat(w, 100, axis=0) for w in (wi, wo)]  # by another loop
    measured.pdf(wi, wo)
    measured.sample(wi, np.full((*wi.shape[:-1], 2), 0.5))
    measured.albedo(wi[:, 0])
    for is_kept in (False, True):  # kept directions are read-only
        for w in (wi, wo, *many):
            w.setflags(write=not is_kept)
        pairs = Pairs(wi, wo)
        measured.eval(*many)
        measured.eval_at(pairs)
        total = np.zeros((len(pairs), measured.bands.count), WeightedSum.dtype)
        WeightedSum([measured], [1.0], cube_root=True).add_to(total, pairs)
    dequantise(
        np.ones((1, 1, 2, 2), np.int32),
        np.ones((1, 3), np.float32),
        np.float32(0.0),
        np.ones((1, 2, 2, 3), np.float32),
    )


def compile_models() -> None:
    """Fit a latent-variable model by its search, and weights that may only add."""
    warnings.simplefilter("ignore")  # three samples far from each other
    GPLVM(1, optimizer="dls", max_iter=1).fit(np.eye(3))
    nonnegative_weights(np.eye(2), np.ones((1, 2)))
    squared_valleys(np.eye(2), np.ones((2, 1, 3, 1)), np.zeros(2))


if __name__ == "__main__":
    compile_rendering()
    compile_models()
