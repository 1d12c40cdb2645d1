"""Estimates the expected error of a prediction at a latent, from the errors of left-out materials.

The latents of the other materials stay fixed while a material is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from manifold.brdf.measured import values_at
from manifold.colour import panel
from manifold.core import progress
from manifold.core.mapping import CubeRoot, ValueMapping
from manifold.core.metrics import Errors
from manifold.core.records import AnyArray, Array, Indices, Mask, evenly_spaced
from manifold.gp.encoding import encoding_pairs
from manifold.model.blend_fitting import BlendSamples
from manifold.model.blend_space import BlendSpace
from manifold.model.blending import blend_weights, nearest_distance, widest_gap
from manifold.model.coherence import Coherence, Pair, measure_coherence
from manifold.model.combination import Combination
from manifold.model.decoding import appearance_pairs, roots_at
from manifold.model.landmarks import LandmarkSearch, combined, farthest_samples
from manifold.model.latent_space import LatentSpace, LeftOutSearch, require_shapes
from manifold.model.materials import MaterialCache, MaterialTable
from manifold.model.settings import COMPARED_BANDS, Settings
from manifold.registries import MAPPINGS

LEAST_MATERIALS = 4
"""Smallest number of materials for which expected errors are calibrated."""

NOT_CALIBRATED = (
    "the model has no expected errors, or those of other lights or an earlier version",
    f"embed the library again, with {LEAST_MATERIALS} materials or more",
)

BELOW_TWICE = 0.9
"""Share of the leave-one-out errors that are below twice the expected error."""

COARSE_BELOW = 8
"""Number of materials below which expected errors are uncertain by a factor of three, and hardly vary over the map."""

LEVEL = 0.9
"""Share of new materials whose true error should be below `Reliability.bound` times the expected error."""

_LIKE = 2.0  # number of materials at which the power a is one half (docs/explanation/expected-errors.md)
_LEAST_RESIDUAL = 1e-4
_RESIDUAL = 0.75  # power of a material's own residual, where it is known; the rest is that of its place
_FAR = 0.25  # power with which errors grow with the distance to the nearest material, in length scales


@dataclass(frozen=True, eq=False)
class ExpectedError:
    """The expected error e(x) as a function of the latent x, interpolated between leave-one-out errors of N materials.

    `e(x) = c m prod (e_i / m)^(a u_i(x)) hypot(1, d(x))^(1/4)` with a = N / (N + 2); only the factor c is fitted.

    It averages the logarithms of the leave-one-out errors e_i with the weights u of a blend at x. The power a shrinks
    the e_i towards their geometric mean m, more strongly for fewer materials. Errors grow with the distance d to the
    nearest material, in length scales. If d exceeds g, the largest distance between a material and its nearest
    neighbour, the error is at least m (d / g)^2, up to the largest e_i. For a material whose residual r at x is
    known, the expected error is `c e(x)^(1/4) r^(3/4)`.

    Attributes:
        X: latents of the materials, shape (N, Q).
        log_errors: logarithms of the leave-one-out errors e_i, shape (N,).
        length_scale: length scale of the weights u.
        log_factor: logarithm of c.
    """

    X: Array
    log_errors: Array
    length_scale: float
    log_factor: float

    @classmethod
    def calibrate(
        cls,
        X: Array,
        places: Array,
        errors: Array,
        length_scale: float,
        floor: float,
        residuals: Array | None = None,
    ) -> ExpectedError:
        """Fit c so that half of the leave-one-out errors are below the expected error, and 90 % are below twice that.

        Args:
            X: latents of the materials, shape (N, Q).
            places: latents at which the materials were found when they were left out, shape (N, Q).
            errors: leave-one-out errors, shape (N,).
            length_scale: length scale of the weights.
            floor: smallest error; smaller errors are replaced by it.
            residuals: residuals of the left-out materials, shape (N,), if expected errors use known residuals.
        """
        logs = np.log(np.maximum(errors, floor))
        off = np.empty(len(X))
        for i in range(len(X)):
            others = np.delete(np.arange(len(X)), i)
            residual, place = None if residuals is None else residuals[i], places[i : i + 1]
            of_others = cls(X[others], logs[others], length_scale, 0.0)
            off[i] = logs[i] - of_others._log_at(place, nearest_distance(place, X[others]), residual)[0]
        factor = max(float(np.median(off)), float(np.quantile(off, BELOW_TWICE)) - np.log(2.0))
        return cls(X, logs, length_scale, factor)

    def at(self, x: Array, residual: float | None = None) -> Array:
        """Return the expected errors at latents x (M, Q), shape (M,).

        `residual` is the residual of the material, if known.
        """
        nearest = nearest_distance(x, self.X)
        expected = np.exp(self._log_at(x, nearest, residual))
        return expected if residual is not None else np.maximum(expected, self._floor(nearest))

    def _floor(self, nearest: Array) -> Array:
        """Return the lower bound of the expected error, shape (M,), at distances (M,) from the nearest material."""
        mean, most = np.exp(self.log_errors.mean()), np.exp(self.log_errors.max())
        return np.asarray(np.minimum(mean * (nearest / widest_gap(self.X)) ** 2, max(most, mean)))

    def _log_at(self, x: Array, nearest: Array, residual: float | None) -> Array:
        u = blend_weights(x, self.X, self.length_scale)
        mean, power = self.log_errors.mean(), len(self.X) / (len(self.X) + _LIKE)
        around = mean + power * (u @ self.log_errors - mean)
        log = around + _FAR * np.log(np.hypot(1.0, nearest / self.length_scale))
        if residual is not None:
            log = (1.0 - _RESIDUAL) * log + _RESIDUAL * np.log(max(residual, _LEAST_RESIDUAL))
        return self.log_factor + log


@dataclass(frozen=True)
class Reliability:
    """A comparison of expected and true errors of left-out materials.

    Attributes:
        true, expected: median and 90th percentile of the true and of the expected errors.
        rank_correlation: Spearman's rank correlation of expected and true errors.
        below_twice: share of true errors that are below twice the expected error.
        bound: factor on the expected error below which the true errors of 90 % of new materials should lie; None if
            there are too few materials. It is a quantile of leave-one-out errors (jackknife), without a guarantee.
        most_level: the highest share, instead of 90 %, for which the number of materials allows a bound.

    Source: Barber, Candes, Ramdas & Tibshirani 2021, on the jackknife; true errors are divided by expected errors.
    """

    true: tuple[float, float]
    expected: tuple[float, float]
    rank_correlation: float
    below_twice: float
    bound: float | None
    most_level: float

    @classmethod
    def of(cls, true: Array, expected: Array) -> Reliability:
        """Compare true errors (N,) with the errors (N,) that were expected without the material."""
        from scipy.stats import spearmanr  # takes half a second to import, and predictions do without

        n = len(true)
        k = int(np.ceil(LEVEL * (n + 1)))
        true_both, expected_both = (
            (float(np.median(e)), float(np.quantile(e, 0.9))) for e in (true, expected)
        )
        return cls(
            true_both, expected_both, float(spearmanr(expected, true)[0]), float(np.mean(true < 2.0 * expected)),
            float(np.sort(true / expected)[k - 1]) if k <= n else None, n / (n + 1.0),
        )  # fmt: skip


# Arrays of files; those of 0.2.0 have errors in the studio alone, by "left_out_", and are not used.
_PREFIX = "left_out_in_lights_"
_ARRAYS = ("places", "ball", "cube_root", "residual", "materials", "panel")
_BLENDED = "blended_"
_SAMPLE = 200  # materials that are left out where not all were laid out: spread evenly over the map
_MOST_BALL = 10.0  # CIEDE2000: the appearance of another material
_LEAST = {"ball": 0.05, "cube_root": 1e-3}  # errors below cannot be seen


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The latents at which n left-out materials of a space are found, and the errors of the predictions there.

    Attributes:
        places: latents at which the materials were found, shape (n, Q).
        errors: ball errors, and cube-root errors on the encoding grid, in the given colour of the material, each
            (n,).
        blended: the same errors in blended colours; None if the latents determine the colours.
        residual: residuals of the search, see `Embedded`, shape (n,).
        materials: indices of the left-out materials, shape (n,): all, or a selection on a map with landmarks.
    """

    space: LatentSpace
    places: Array
    errors: Errors[Array]
    blended: Errors[Array] | None
    residual: Array
    materials: Indices

    @property
    def arrays(self) -> dict[str, AnyArray]:
        """The arrays that a file stores, by name."""
        arrays: dict[str, AnyArray] = {
            "places": self.places, "residual": self.residual, "materials": self.materials,
            "panel": np.array([panel.judged().signature]),
            **self._by_name(self.errors),
        }  # fmt: skip
        if self.blended is not None:
            arrays |= {_BLENDED + name: values for name, values in self._by_name(self.blended).items()}
        return {_PREFIX + name: values for name, values in arrays.items()}

    @classmethod
    def from_arrays(cls, stored: Mapping[str, Array], space: LatentSpace) -> LeftOut | None:
        """Restore the errors from a file's arrays.

        Returns None if they were computed with other lights or by another version.
        """
        names = _ARRAYS + tuple(_BLENDED + name for name in _LEAST if space.takes_colours)
        if not {_PREFIX + name for name in names} <= set(stored):
            return None
        count = len(stored[_PREFIX + "materials"])
        shapes = {
            _PREFIX + name: {"places": (count, space.X.shape[1]), "panel": (1,)}.get(name, (count,))
            for name in names
        }
        places, ball, cube_root, residual, materials, lights, *blended = require_shapes(stored, shapes)
        if lights[0] != panel.judged().signature:
            return None
        if not np.all(np.diff(materials) > 0) or materials.min() < 0 or materials.max() >= len(space.X):
            raise ValueError("left-out materials are not those of the map")
        in_blended = Errors(ball=blended[0], cube_root=blended[1]) if blended else None
        indices = materials.astype(np.int64)
        return cls(space, places, Errors(ball, cube_root), in_blended, residual, indices)

    @staticmethod
    def _by_name(errors: Errors[Array]) -> dict[str, Array]:
        return {name: getattr(errors, name) for name in _LEAST}

    def expected(
        self, x: Array, residual: float | None = None, *, is_colour_known: bool = True
    ) -> Errors[Array]:
        """Return the expected errors at latents x (M, Q), shape (M,), or at one latent (Q,), shape ().

        The true errors of nine in ten left-out materials are less than twice the expected errors.

        Args:
            x: the latents.
            residual: residual of a material that was located at x in its own colours; None if there is none.
            is_colour_known: whether the colour of the material is given; otherwise it is blended.
        """
        calibrated = (
            self._of_residuals if residual is not None else self._of_places if is_colour_known
            else self._of_blended
        )  # fmt: skip
        ball, cube_root = (each.at(np.atleast_2d(x), residual).reshape(x.shape[:-1]) for each in calibrated)
        return Errors(ball, cube_root)

    def is_unsupported(self, x: Array) -> Mask:
        """Return whether predictions at latents x (M, Q) are not supported by the data, shape (M,).

        A prediction is not supported if its expected ball error is above 10 CIEDE2000 and above the 90th percentile
        of the left-out materials' errors, or if the nearest material is farther away than any material is
        from its nearest neighbour.
        """
        X = self.space.X
        is_far = nearest_distance(x, X) > widest_gap(X)
        most = max(_MOST_BALL, float(np.quantile(self.errors.ball, 0.9)))
        return is_far | (self.expected(x).ball > most)

    def reliability(self) -> dict[str, Reliability]:
        """Return comparisons of the true error of every material with the error expected from the other materials.

        The keys are `ball` and `cube_root` and, if colours can be blended, `blended_ball` and `blended_cube_root`.
        """
        X, scale = self._calibrated
        reliabilities = {}
        for kind, errors in (("", self.errors), (_BLENDED, self.blended)):
            for name, values in ({} if errors is None else self._by_name(errors)).items():
                expected = np.empty_like(values)
                for i in range(len(X)):
                    others = np.delete(np.arange(len(X)), i)
                    fitted = ExpectedError.calibrate(
                        X[others], self.places[others], values[others], scale, _LEAST[name]
                    )
                    expected[i] = fitted.at(self.places[i : i + 1])[0]
                reliabilities[kind + name] = Reliability.of(values, expected)
        return reliabilities

    @property
    def _calibrated(self) -> tuple[Array, float]:
        """Latents of the calibrated materials (n, Q), and the length scale adjusted to their lower density."""
        X, n = self.space.X, len(self.materials)
        return X[self.materials], self.space.kernel.length_scale * (len(X) / n) ** (1.0 / X.shape[1])

    @cached_property
    def _of_places(self) -> list[ExpectedError]:
        return self._calibrate(self.errors)

    @cached_property
    def _of_blended(self) -> list[ExpectedError]:
        return self._of_places if self.blended is None else self._calibrate(self.blended)

    @cached_property
    def _of_residuals(self) -> list[ExpectedError]:
        return self._calibrate(self.errors, self.residual)

    def _calibrate(self, errors: Errors[Array], residuals: Array | None = None) -> list[ExpectedError]:
        X, scale = self._calibrated
        return [
            ExpectedError.calibrate(X, self.places, values, scale, _LEAST[name], residuals)
            for name, values in self._by_name(errors).items()
        ]


def leave_out(
    space: LatentSpace,
    materials: MaterialCache,
    settings: Settings,
    samples: BlendSamples | None = None,
) -> tuple[LeftOut, Coherence | None]:
    """Leave out each material once, locate it from its data, measure its prediction.

    Return the errors and the coherence. Predictions have the material's own colour and, if colours can be given, also
    the blended colour. The latents of the other materials stay fixed. On a map with landmarks, 200 materials are left
    out instead of all; `samples` are the samples to which such a map was fitted.
    """
    bands = bands_of_errors(space, materials.library.bands.count)
    chosen = np.arange(len(space.X))
    if isinstance(space, BlendSpace) and samples is not None:
        chosen = np.sort(farthest_samples(_SAMPLE, lambda i: np.linalg.norm(space.X - space.X[i], axis=1)))
        find, measure = _landmark_left_out(space, materials, bands, samples)
        coherence, _ = measure_coherence(space.X, *_landmark_balls(space, materials, bands, samples))
    else:
        table = MaterialTable(materials.with_negative_values(), bands)
        find, measure = space.left_out_search(table, materials, settings), table.errors
        coherence, _ = coherence_of(space, table, MAPPINGS[settings.mapping])
    places, residual = np.empty((len(chosen), space.X.shape[1])), np.empty(len(chosen))
    errors: list[Errors[float]] = []
    blended: list[Errors[float]] = []
    for k, i in progress.each(enumerate(chosen.tolist()), "left-out materials"):
        places[k], combination, residual[k] = find(i)
        errors.append(measure(i, combination))
        if isinstance(space, BlendSpace):
            blended.append(measure(i, _blended(space, i, places[k], bands, samples)))
    left_out = LeftOut(
        space, places, _of_several(errors), _of_several(blended) if blended else None, residual, chosen
    )
    return left_out, coherence


def bands_of_errors(space: LatentSpace, n_bands: int) -> Indices:
    """Return the indices of the bands in which errors are measured: some evenly spaced ones, and the sample bands."""
    return np.union1d(evenly_spaced(n_bands, COMPARED_BANDS), space.embedding_bands(n_bands))


def coherence_of(
    space: LatentSpace, table: MaterialTable, mapping: ValueMapping
) -> tuple[Coherence | None, list[Pair]]:
    """Return the coherence of a map in blended colours, and its pairs of similar materials."""
    return measure_coherence(
        space.X, table.balls.__getitem__, lambda x: table.ball(space.combination(x, None, mapping))
    )


def _landmark_balls(
    space: BlendSpace, materials: MaterialCache, bands: Indices, samples: BlendSamples
) -> tuple[Callable[[int], Array], Callable[[Array], Array]]:
    """Return functions that compute CIE XYZ of the ball of a material, and of a point, from samples.

    The balls are not stored, because thousands of them would fill the memory.
    """
    lights, axis = panel.judged(), materials.library.bands.select(bands.tolist())

    def ball(u: Array) -> Array:
        weights = space.paths.weights(u, space.own_colours[:, bands])
        return lights.xyz(combined(weights, samples.on_ball).T ** 3.0, axis)

    everything = np.arange(len(space.X))
    return (
        lambda i: ball((everything == i).astype(np.float64)),
        lambda x: ball(space.material_weights(x[None], None)[0]),
    )


def _of_several(errors: list[Errors[float]]) -> Errors[Array]:
    every = Errors.of_several(errors)
    return Errors(every.ball, every.cube_root)


def _blended(
    space: BlendSpace, i: int, x: Array, bands: Indices, samples: BlendSamples | None
) -> Combination:
    """Return the prediction at x (Q,) without material i, in colours blended from the others.

    On a map with landmarks, only samples are available, so each material contributes its colour path at its own colour.
    """
    u = space.weights_without(i, x)
    if samples is None:
        return Combination(CubeRoot(), u)
    weights = space.paths.weights(u, space.own_colours[:, bands])
    return Combination(CubeRoot(), weights, np.searchsorted(bands, space.bands))


def _landmark_left_out(
    space: BlendSpace, materials: MaterialCache, bands: Indices, samples: BlendSamples
) -> tuple[LeftOutSearch, Callable[[int, Combination], Errors[float]]]:
    """Return a search for a material among the others, and a function that returns the errors of its prediction.

    The errors in some bands (B',) are those of `MaterialTable.errors`; only materials that are left out are
    read.
    """
    at, lights = np.searchsorted(bands, space.bands), panel.judged()
    search = LandmarkSearch(space, samples.roots, bands)
    pairs, grid = appearance_pairs(materials.is_isotropic), encoding_pairs(materials.is_isotropic)

    def find(i: int) -> tuple[Array, Combination, float]:
        (brdf,) = materials.filled([materials.names[i]])
        target = roots_at([brdf.select_bands(bands.tolist())], pairs)
        x, colours, residual = search.find(target, at, without=i)
        weights = space.paths.weights(space.weights_without(i, x), colours[0]) * colours[1][:, None]
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
