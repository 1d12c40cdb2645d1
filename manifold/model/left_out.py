"""Leave-one-out with the latents of the others kept: the calibration of expected errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from manifold import progress
from manifold.brdf.measured import values_at
from manifold.colour import panel
from manifold.encoding import encoding_pairs
from manifold.mapping import CubeRoot
from manifold.metrics import Errors
from manifold.model.appearance import appearance_pairs, roots_at
from manifold.model.blend_fitting import BlendSamples
from manifold.model.blend_space import BlendSpace
from manifold.model.blending import blend_weights, widest_gap
from manifold.model.combination import Combination
from manifold.model.expected_error import ExpectedError, Reliability
from manifold.model.landmarks import LandmarkSearch, combined, farthest_samples
from manifold.model.latent_space import LatentSpace, LeftOutSearch, require_shapes
from manifold.model.material_table import MaterialTable
from manifold.model.materials import MaterialCache
from manifold.model.settings import Settings
from manifold.records import Array, Indices, Mask, evenly_spaced


def landmark_left_out(
    space: BlendSpace, materials: MaterialCache, bands: Indices, samples: BlendSamples
) -> tuple[LeftOutSearch, Callable[[int, Combination], Errors[float]]]:
    """A search for a material among the others, and what tells the errors of its prediction in some bands (B',).

    The errors are those of `MaterialTable.errors`; only materials that are left out are read.
    """
    at, lights = np.searchsorted(bands, space.bands), panel.judged()
    search = LandmarkSearch(space, samples.roots, bands)
    pairs, grid = appearance_pairs(materials.is_isotropic), encoding_pairs(materials.is_isotropic)

    def find(i: int) -> tuple[Array, Combination, float]:
        (brdf,) = materials.filled([materials.names[i]])
        target = roots_at([brdf.select_bands(bands.tolist())], pairs)
        x, colours, residual = search.find(target, at, without=i)
        others = np.delete(np.arange(len(space.X)), i)
        u = np.zeros(len(space.X))
        u[others] = blend_weights(x[None], space.X[others], space.kernel.length_scale)[0]
        weights = space.paths.weights(u, colours[0]) * colours[1][:, None]
        return x, Combination(CubeRoot(), weights, at), residual

    def measure(i: int, combination: Combination) -> Errors[float]:
        (brdf,) = materials.with_negative_values(names=[materials.names[i]])
        truth = brdf.select_bands(bands.tolist())
        on_ball, in_grid = (
            np.maximum(combined(combination.weights, table), 0.0).T ** 3
            for table in (samples.on_ball, samples.roots[:, : len(grid)])
        )
        look = lights.errors(values_at(truth, lights), on_ball, truth.bands)
        return look | Errors.of_values(values_at(truth, grid), in_grid, grid.cosines)

    return find, measure


_BANDS = 12  # in which errors are measured, evenly spaced, beside those of the samples
# Files of 0.2.0 hold errors in the studio alone, by "left_out_": they are not calibrated.
_PREFIX, _ARRAYS = "left_out_in_lights_", ("places", "ball", "cube_root", "residual", "materials")
_SAMPLE = 200  # materials that are left out where not all were laid out: spread evenly over the map
_MOST_BALL = 10.0  # CIEDE2000: the appearance of another material
_LEAST = {"ball": 0.05, "cube_root": 1e-3}  # errors below cannot be seen


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The places at which materials of a space are found when they are left out, and the errors of predictions there.

    Attributes:
        space: of N materials.
        places: shape (n, Q).
        errors: of the ball, and of cube roots on the encoding grid, each (n,).
        residual: of the search, see `Embedded`, shape (n,).
        materials: which they are: all, or some of those of a map by landmarks, shape (n,).
    """

    space: LatentSpace
    places: Array
    errors: Errors[Array]
    residual: Array
    materials: Indices

    @property
    def arrays(self) -> dict[str, Array]:
        """The arrays that a file stores, by name."""
        known = vars(self) | {name: getattr(self.errors, name) for name in _LEAST}
        return {_PREFIX + name: known[name] for name in _ARRAYS}

    @classmethod
    def from_arrays(cls, stored: Mapping[str, Array], space: LatentSpace) -> LeftOut | None:
        """Those of a file's arrays; None where the model was not calibrated."""
        if _PREFIX + "residual" not in stored:  # nor those of older files, which do not have it
            return None
        count = len(stored[_PREFIX + "materials"])
        shapes = {
            _PREFIX + name: (count, space.X.shape[1]) if name == "places" else (count,) for name in _ARRAYS
        }
        places, ball, cube_root, residual, materials = require_shapes(stored, shapes)
        if not np.all(np.diff(materials) > 0) or materials.min() < 0 or materials.max() >= len(space.X):
            raise ValueError("left-out materials are not those of the map")
        return cls(space, places, Errors(ball, cube_root), residual, materials.astype(np.int64))

    def expected(self, x: Array, residual: float | None = None) -> Errors[Array]:
        """Expected errors at latents x (M, Q) or (Q,), of a material of a residual if that is known, (M,) or ().

        The errors of nine in ten left-out materials are less than twice as large.
        """
        calibrated = self._of_places if residual is None else self._of_residuals
        ball, cube_root = (each.at(np.atleast_2d(x), residual).reshape(x.shape[:-1]) for each in calibrated)
        return Errors(ball, cube_root)

    def is_unsupported(self, x: Array) -> Mask:
        """Whether predictions at latents x (M, Q) are not supported by the data, shape (M,).

        They are not where the ball's expected error is above 10 CIEDE2000 and above the 90th percentile of the left-out
        materials, or where the nearest material is farther than any material is from its nearest other one.
        """
        X = self.space.X
        is_far = KDTree(X).query(x)[0] > widest_gap(X)
        most = max(_MOST_BALL, float(np.quantile(self.errors.ball, 0.9)))
        return is_far | (self.expected(x).ball > most)

    def reliability(self) -> dict[str, Reliability]:
        """Expected errors of each material, by the others alone, against its true ones."""
        (X, scale), found = self._calibrated, {}
        for name, least in _LEAST.items():
            errors = getattr(self.errors, name)
            expected = np.empty_like(errors)
            for i in range(len(X)):
                others = np.delete(np.arange(len(X)), i)
                fitted = ExpectedError.calibrate(X[others], self.places[others], errors[others], scale, least)
                expected[i] = fitted.at(self.places[i : i + 1])[0]
            found[name] = Reliability.of(errors, expected)
        return found

    @property
    def _calibrated(self) -> tuple[Array, float]:
        """Places of the materials (n, Q), and a length scale that reaches as many of them as the map's of all."""
        X, n = self.space.X, len(self.materials)
        return X[self.materials], self.space.kernel.length_scale * (len(X) / n) ** (1.0 / X.shape[1])

    @cached_property
    def _of_places(self) -> list[ExpectedError]:
        return self._calibrate(None)

    @cached_property
    def _of_residuals(self) -> list[ExpectedError]:
        return self._calibrate(self.residual)

    def _calibrate(self, residuals: Array | None) -> list[ExpectedError]:
        X, scale = self._calibrated
        return [
            ExpectedError.calibrate(X, self.places, getattr(self.errors, name), scale, least, residuals)
            for name, least in _LEAST.items()
        ]


def leave_out(
    space: LatentSpace,
    materials: MaterialCache,
    settings: Settings,
    samples: BlendSamples | None = None,
) -> LeftOut:
    """Leave out materials of a space once, find their places from their data, and measure their predictions there.

    The places of the other materials are kept. Every material is left out, or, on a map by landmarks, 200.

    Args:
        space: of the materials.
        materials: in its order.
        settings: of the fit.
        samples: that a map by landmarks was fitted to.
    """
    n_bands = materials.library.bands.count
    bands = np.union1d(evenly_spaced(n_bands, _BANDS), space.embedding_bands(n_bands))
    chosen = np.arange(len(space.X))
    if isinstance(space, BlendSpace) and samples is not None:
        chosen = np.sort(farthest_samples(_SAMPLE, lambda i: np.linalg.norm(space.X - space.X[i], axis=1)))
        find, measure = landmark_left_out(space, materials, bands, samples)
    else:
        table = MaterialTable(materials.with_negative_values(), bands)
        find, measure = space.left_out_search(table, materials, settings), table.errors
    places, residual, errors = np.empty((len(chosen), space.X.shape[1])), np.empty(len(chosen)), []
    for k, i in progress.each(enumerate(chosen.tolist()), "left-out materials"):
        places[k], combination, residual[k] = find(i)
        errors.append(measure(i, combination))
    found = Errors.of_several(errors)
    return LeftOut(space, places, Errors(found.ball, found.cube_root), residual, chosen)
