"""Leave-one-out on maps by landmarks, from samples that were evaluated once."""

from __future__ import annotations

import numpy as np

from manifold.colour import ball_colours
from manifold.latent.blending import blend_weights
from manifold.mapping import CubeRoot
from manifold.metrics import cube_root_error
from manifold.model.appearance import roots_at
from manifold.model.blend_fitting import BlendSamples
from manifold.model.blend_space import BlendSpace
from manifold.model.combination import Combination
from manifold.model.landmark_search import LandmarkSearch, combined
from manifold.model.latent_space import LeftOutErrors, LeftOutSearch
from manifold.model.materials import MaterialCache
from manifold.records import Array, Indices


def landmark_left_out(
    space: BlendSpace, materials: MaterialCache, bands: Indices, samples: BlendSamples
) -> tuple[LeftOutSearch, LeftOutErrors]:
    """A search for a material among the others, and what tells the errors of its prediction in some bands (B',).

    The errors are those of `MaterialTable.errors`; only materials that are left out are read.
    """
    at, pairs, ball = np.searchsorted(bands, space.bands), samples.pairs, ball_colours.ball()
    search, grid = LandmarkSearch(space, samples.roots, bands), slice(None, samples.pairs.n_grid)

    def find(i: int) -> tuple[Array, Combination, float]:
        (brdf,) = materials.filled([materials.names[i]])
        target = roots_at([brdf.select_bands(bands.tolist())], pairs.pairs)
        x, colours, residual = search.find(target, at, without=i)
        others = np.delete(np.arange(len(space.X)), i)
        u = np.zeros(len(space.X))
        u[others] = blend_weights(x[None], space.X[others], space.kernel.length_scale)[0]
        weights = space.paths.weights(u, colours[0]) * colours[1][:, None]
        return x, Combination(CubeRoot(), weights, at), residual

    def measure(i: int, combination: Combination) -> tuple[float, float]:
        (brdf,) = materials.with_negative_values(names=[materials.names[i]])
        truth = brdf.select_bands(bands.tolist())
        on_ball, in_grid = (
            np.maximum(combined(combination.weights, table), 0.0).T ** 3
            for table in (samples.on_ball, samples.roots[:, grid])
        )
        at_grid = truth.eval(pairs.pairs.wi[grid], pairs.pairs.wo[grid])
        return (
            ball.difference(truth.eval(ball.wi, ball.wo), on_ball, truth.bands),
            cube_root_error(at_grid, in_grid, pairs.pairs.cosines[grid]),
        )

    return find, measure
