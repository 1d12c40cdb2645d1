"""Decodes latents as `T^-1(V T(F))`, and finds the latents at which new materials are reproduced best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import scipy

from manifold.core.mapping import ValueMapping
from manifold.core.metrics import cube_root_error, relative_error
from manifold.core.pairs import Pairs, RusinkiewiczGrid
from manifold.core.records import Array
from manifold.gpr import GaussianProcess

Criterion = Callable[[Array, float], tuple[float, Array, float]]
"""A function of weights V (n,) and variance v that returns a value and its derivatives with respect to V (n,) and v."""

# Relative to a material's root mean square: the slope of smaller cube roots is that of this one.
_SMALLEST_ROOT = 1e-3
_ROUNDING = 1e-14  # relative rounding error of squared distances, which are differences of large numbers


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of a new material and n training materials in the mapped domain, centred on the training mean.

    Attributes:
        S: inner products among the training materials, shape (n, n).
        cross: inner products of the new material with the training materials, shape (n,).
        norm: squared norm of the new material.
    """

    S: Array
    cross: Array
    norm: float

    @classmethod
    def centred(cls, S: Array, cross: Array, norm: float) -> Products:
        """Centre inner products S (n, n), cross (n,) and norm that refer to any other origin."""
        row_mean, mean, mean_cross = S.mean(axis=1), S.mean(), float(cross.mean())
        return cls(
            S - row_mean[:, None] - row_mean[None] + mean,
            cross - mean_cross - row_mean + mean,
            max(float(norm - 2.0 * mean_cross + mean), 0.0),
        )

    @property
    def distances(self) -> Array:
        """Squared distances from the training materials, shape (n,)."""
        return self.norm + np.diag(self.S) - 2.0 * self.cross

    def residual(self, V: Array) -> tuple[float, Array]:
        """Return the squared distance `||y - V Y||^2` from the prediction, and its derivative in V (n,)."""
        VS = V @ self.S
        squared = self.norm - 2.0 * float(V @ self.cross) + float(VS @ V)
        floor = _ROUNDING * (self.norm + np.trace(self.S) / len(self.S))
        return max(squared, floor), 2.0 * (VS - self.cross)


def mapped_residual(products: Products) -> Criterion:
    """Return the criterion `1/2 log ||T(f) - V T(F)||^2`."""

    def criterion(V: Array, v: float) -> tuple[float, Array, float]:
        squared, slope = products.residual(V)
        return 0.5 * float(np.log(squared)), 0.5 / squared * slope, 0.0

    return criterion


def likelihood(products: Products, scale: float) -> Criterion:
    """Return the criterion `1/2 log v + ||T(f) - V T(F)||^2 / (2 D s^2 v)`, with `scale` = D s^2.

    The residual is divided by the posterior variance v, which is therefore calibrated at the latent found.

    Source: Lawrence 2005, section 3.1; Rasmussen & Williams 2006, eq. 5.8.
    """

    def criterion(V: Array, v: float) -> tuple[float, Array, float]:
        squared, slope = products.residual(V)
        misfit = 0.5 * squared / (scale * v)
        return float(0.5 * np.log(v) + misfit), 0.5 * slope / (scale * v), (0.5 - misfit) / v

    return criterion


def decoded_error(decoder: Decoder, f: Array) -> Criterion:
    """Return the criterion `1/2 log ||(w f*)^(1/3) - (w f)^(1/3)||^2` of values f (P,), with cosines `w`."""
    w = decoder.cosines
    target = np.cbrt(w * f)
    floor = _ROUNDING * float(target @ target) + np.finfo(float).tiny
    # The slope of a cube root is unbounded at 0, where the search would diverge.
    steepest = 3.0 * _SMALLEST_ROOT**2 * float(np.mean(target * target)) + np.finfo(float).tiny

    def criterion(V: Array, v: float) -> tuple[float, Array, float]:
        values, slope = (one[0] for one in decoder.combine(V[None]))
        found = np.cbrt(w * values)
        difference = found - target
        squared = max(float(difference @ difference), floor)
        slope = w * slope / np.maximum(3.0 * found * found, steepest)
        return 0.5 * float(np.log(squared)), decoder.mapped @ (difference * slope) / squared, 0.0

    return criterion


PAIR_STRIDE = 6  # one in this many of a grid's direction pairs is used to find a latent


@cache
def encoding_pairs(is_isotropic: bool = True) -> Pairs:
    """Return the pairs of the default grid at which new materials are compared with predictions, cached and read-only.

    For anisotropic materials, the half vectors have all azimuths.
    """
    return RusinkiewiczGrid.named("default").suited_to(is_isotropic).pairs(PAIR_STRIDE)


@dataclass(frozen=True, eq=False)
class Decoder:
    """Maps latents to BRDF values at P outputs: direction pairs of one band, or pairs and bands.

    Attributes:
        mapped: mapped values of the n training samples, shape (n, P).
        mapping: the mapping T.
        cosines: cos(theta_i) cos(theta_o) of each output, shape (P,).
    """

    gp: GaussianProcess
    mapped: Array
    mapping: ValueMapping
    cosines: Array

    def decode(self, latents: Array) -> Array:
        """Return values f in 1/sr at latents (R, Q), at least 0, shape (R, P)."""
        return self._values(self.gp.weights(latents) @ self.mapped)

    def nearest_sample(self, f: Array) -> tuple[int, float]:
        """Return the training sample nearest to values f (P,) in cube roots, and its cube-root error."""
        errors = [
            cube_root_error(f[:, None], own[:, None], self.cosines) for own in self._values(self.mapped)
        ]
        nearest = int(np.argmin(errors))
        return nearest, errors[nearest]

    def combine(self, V: Array) -> tuple[Array, Array]:
        """Return the values (R, P) for weights V (R, n), possibly negative, and the slope of T^-1 there."""
        values = self.mapping.inverse(V @ self.mapped, self.cosines)
        return values, self.mapping.slope(values, self.cosines)

    def map(self, f: Array) -> Array:
        """Apply T to values f (R, P), same shape."""
        return self.mapping.forward(f, self.cosines)

    def relative_error(self, latents: Array, f: Array) -> float:
        """Return the error of the values decoded at latents (R, Q) against f (R, P); see `metrics.relative_error`."""
        return relative_error(f.T, self.decode(latents).T, self.cosines)

    def _values(self, mapped: Array) -> Array:
        """Return the values f, at least 0, of mapped values, same shape (R, P)."""
        return np.maximum(self.mapping.inverse(mapped, self.cosines), 0.0)


_STARTS = 5  # nearest training materials to start from
_REFINED = 3  # minima of the first search that the second one starts from
_APART = 1e-2  # largest difference of latents of one minimum
_MAX_ITER = 200


@dataclass(frozen=True, eq=False)
class Encoder:
    """Finds the latent (Q,) of a new material: minimises a criterion plus `prior / 2 ||x||^2`.

    Attributes:
        gp: Gaussian process of the n training materials.
        S: Gram matrix of the mapped materials, not centred, shape (n, n).
        n_outputs: D, the number of outputs from which S was computed.
        prior: weight of the Gaussian prior on the latent, or one weight per axis, shape (Q,).
        fixed_variance: s^2; None selects the value that maximises the likelihood of the training materials.
    """

    gp: GaussianProcess
    S: Array
    n_outputs: int
    prior: float | Array = 0.0
    fixed_variance: float | None = None

    @classmethod
    def of_decoder(cls, decoder: Decoder, prior: float | Array = 0.0) -> Encoder:
        """Return an encoder that compares materials at the outputs of a decoder, weighted by the cosines."""
        S = (decoder.mapped * decoder.cosines) @ decoder.mapped.T
        return cls(decoder.gp, S, decoder.mapped.shape[1], prior)

    # -- encoding ------------------------------------------------------------------------------------------

    def by_values(self, decoder: Decoder, f: Array) -> Array:
        """Return the latent (Q,) whose decoded values are nearest to f (P,) at the decoder's outputs, in cube roots."""
        T = decoder.map(f[None])[0]
        weighted = T * decoder.cosines
        products = Products.centred(self.S, decoder.mapped @ weighted, float(weighted @ T))
        first = mapped_residual(products)
        ends = [self.minimise(first, start) for start in self.starts(products)]
        apart: list[Array] = []  # the best minima that are not close to each other
        for latent, _ in sorted(ends, key=lambda end: end[1]):
            if all(np.abs(latent - other).max() > _APART for other in apart):
                apart.append(latent)
        return self._best(decoded_error(decoder, f), apart[:_REFINED])

    def by_residual(self, cross: Array, norm: float) -> Array:
        """Return the latent (Q,) with the smallest residual in the mapped domain; arguments as in `by_likelihood`."""
        products = Products.centred(self.S, cross, norm)
        return self._best(mapped_residual(products), self.starts(products))

    def by_likelihood(self, cross: Array, norm: float) -> Array:
        """Return the latent (Q,) with the largest likelihood.

        `cross` (n,) holds the inner products with the training samples, and `norm` the squared norm, about the origin
        of S.
        """
        products = Products.centred(self.S, cross, norm)
        return self._best(likelihood(products, self.n_outputs * self.output_variance), self.starts(products))

    @cached_property
    def output_variance(self) -> float:
        """The output variance s^2 of the training materials."""
        if self.fixed_variance is not None:
            return self.fixed_variance
        return max(self.gp.output_variance(self.S, self.n_outputs), np.finfo(float).tiny)

    # -- searching -----------------------------------------------------------------------------------------

    def starts(self, products: Products) -> list[Array]:
        """Return the latents (Q,) of the nearest training materials."""
        nearest = np.argsort(products.distances, kind="stable")[:_STARTS]
        return list(self.gp.X[nearest])

    def _best(self, criterion: Criterion, starts: Sequence[Array]) -> Array:
        ends = [self.minimise(criterion, start) for start in starts]
        return min(ends, key=lambda end: end[1])[0]

    def minimise(self, criterion: Criterion, start: Array) -> tuple[Array, float]:
        """Return the latent (Q,) at the local minimum of criterion plus prior near a start, and its value."""
        found = scipy.optimize.minimize(
            lambda x: self.value_and_gradient(criterion, x), start, jac=True, method="L-BFGS-B",
            options={"maxiter": _MAX_ITER},
        )  # fmt: skip
        return found.x, float(found.fun)

    def value_and_gradient(self, criterion: Criterion, x: Array) -> tuple[float, Array]:
        """Return criterion plus prior at a latent x (Q,), and the gradient (Q,)."""
        gp, row = self.gp, x[None]
        k, slope = gp.kernel.smooth_and_slope(row, gp.X)  # [1, n]
        # As cho_solve, whose checks take longer than solving for so few.
        W = scipy.linalg.lapack.dpotrs(gp.L, k.T, lower=1)[0].T
        V = W + (1.0 - W.sum(axis=1, keepdims=True)) / gp.n_samples
        v = gp.kernel.prior_variance - float(k[0] @ W[0])
        value, dV, dv = criterion(V[0], v)
        # Pull the derivatives back through the centring, the solve, and the kernel.
        solved = scipy.linalg.lapack.dpotrs(gp.L, (dV - dV.mean())[:, None], lower=1)[0].T
        gradient = gp.kernel.pull_back(row, gp.X, solved - 2.0 * dv * W, slope)[0] + self.prior * x
        return value + 0.5 * float(np.sum(self.prior * x * x)), gradient
