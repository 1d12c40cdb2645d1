"""The map of a library: latents, weights, uncertainty and expected error at a latent; and its picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manifold.errors import UnknownNameError
from manifold.gpr import GaussianProcess
from manifold.metrics import Errors
from manifold.model.expected_error import LeftOut
from manifold.model.latent_space import LatentSpace
from manifold.model.materials import MaterialCache
from manifold.model.places import (
    Place,
    PlaceLike,
    on_line,
    parse_coordinates,
    parse_walk,
    require_between,
    require_latent,
    require_latents,
)
from manifold.model.settings import Settings
from manifold.names import names_like
from manifold.records import Array, Indices, Mask

_SIZE, _MARGIN = np.array([560.0, 400.0]), np.array([90.0, 24.0])


def map_svg(X: Array, names: Sequence[str]) -> str:
    """Return an SVG picture of latents X (N, Q) and names; one dimension is drawn along a line."""
    X = np.column_stack([X, np.zeros(len(X))])[:, :2]
    low, span = X.min(axis=0), np.maximum(np.ptp(X, axis=0), 1e-9)
    places = (X - low) / span * (_SIZE - 2.0 * _MARGIN) + _MARGIN
    places[:, 1] = _SIZE[1] - places[:, 1]
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#0072b2"/>'
        f'<text x="{x:.1f}" y="{y - 7:.1f}" text-anchor="middle">{escape(name)}</text>'
        for (x, y), name in zip(places.tolist(), names, strict=True)
    )
    width, height = _SIZE.astype(int)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'style="background:white" font-family="sans-serif" font-size="10">{dots}</svg>'
    )


S = TypeVar("S", bound=np.generic)

_PICTURED = 80  # materials with ball and name in a picture of thousands
EXTRAPOLATION = 0.5  # share of the prior variance above which a latent counts as extrapolated


class LatentMap:
    """Latents of materials; weights, uncertainty and expected errors at other latents.

    Attributes:
        names: material names in the order of the latents, N of them.
        left_out: places and errors of left-out materials; None for a model that is not calibrated.
    """

    def __init__(
        self, materials: MaterialCache, space: LatentSpace, settings: Settings, left_out: LeftOut | None
    ) -> None:
        """Take the latents of a cache's materials."""
        self.materials = materials
        self.names = materials.names
        self.space = space
        self.space.X.setflags(write=False)
        self.settings = settings
        self.left_out = left_out

    @property
    def X(self) -> Array:
        """Latents of the materials, read-only, shape (N, Q)."""
        return self.space.X

    @property
    def landmarks(self) -> Indices:
        """The materials that were laid out, by default all, shape (M,)."""
        return np.arange(len(self.names)) if self.space.landmarks is None else self.space.landmarks

    @property
    def pictured(self) -> Indices:
        """The materials that a picture shows with ball and name: all, or 80 of the landmarks, which cover the map."""
        return self.landmarks if self.space.landmarks is None else self.landmarks[:_PICTURED]

    @property
    def gp(self) -> GaussianProcess:
        """The Gaussian process on the latents of the materials."""
        return self.space.gp

    def weights(self, x: ArrayLike | PlaceLike, colours: Array | None = None) -> Array:
        """Return the weights of materials at a place (Q,) or latents x (M, Q), shape (N,) or (M, N); they sum to 1."""
        return self._at(x, colours, self.space.material_weights)

    def std(self, x: ArrayLike | PlaceLike, colours: Array | None = None) -> Array:
        """Return the posterior over prior standard deviation at a place (Q,) or latents x (M, Q), in [0, 1]."""
        return np.sqrt(self._at(x, colours, self.space.variance_fraction))

    def is_extrapolation(self, x: ArrayLike | PlaceLike, colours: Array | None = None) -> Mask:
        """Return whether the data do not support predictions at a place (Q,) or latents x (M, Q).

        See `LeftOut.is_unsupported`.

        For a model that is not calibrated: whether the posterior variance exceeds half of the prior's. Not of a step of
        a walk.
        """
        left_out = self.left_out
        if self._is_step(x, colours):
            return np.zeros((), dtype=bool)
        if left_out is None:
            return self._at(x, colours, self.space.variance_fraction) > EXTRAPOLATION
        is_predicted = self._at(x, colours, self.space.training_indices) < 0
        return is_predicted & self._at(x, None, lambda X, _: left_out.is_unsupported(X))

    def expected_error(
        self, x: ArrayLike | PlaceLike, colours: Array | None = None, residual: float | None = None
    ) -> Errors[Array] | None:
        """Return expected errors of predictions at a place (Q,) or latents x (M, Q).

        They hold for a material with these colours, or, without colours, with those blended from the
        surrounding materials.

        0 at a material's own latent, where the prediction is its file; None if the model is not calibrated, and of a
        step of a walk, in which the map has no part. `residual` is that of an `Embedded` material, which tells more of
        its error than its place does.
        """
        if self.left_out is None or self._is_step(x, colours):
            return None
        found = self.left_out.expected(self._latents(x), residual, is_colour_known=colours is not None)
        if residual is not None:
            return found
        is_predicted = self._at(x, colours, self.space.training_indices) < 0
        return Errors(found.ball * is_predicted, found.cube_root * is_predicted)

    def nearest(self, x: PlaceLike, count: int = 1) -> list[tuple[str, float]]:
        """Return the materials nearest to a latent x (Q,) with their distances, nearest first."""
        distance = np.linalg.norm(self.space.X - self.place(x).latent, axis=1)
        return [(self.names[k], float(distance[k])) for k in np.argsort(distance, kind="stable")[:count]]

    def largest_weights(
        self, x: PlaceLike, count: int, colours: Array | None = None
    ) -> list[tuple[str, float]]:
        """Return the materials with the largest nonzero weights at a latent x (Q,), by magnitude."""
        weights = self.weights(x, colours)
        order = np.argsort(-np.abs(weights), kind="stable")[:count]
        return [(self.names[k], float(weights[k])) for k in order if weights[k] != 0]

    def unmeasured_share(self, x: PlaceLike, colours: Array | None = None) -> float:
        """Return the share of unmeasured cells at a latent x (Q,), averaged over materials by magnitude of weight.

        A step of a walk, whose ends need not be materials of the model, averages over the ends by t.
        """
        place = self.place(x)
        if place.walk is not None and place.is_step(colours):
            start, end, t = place.walk
            of_ends = [
                self.materials.unmeasured_share(name) if name in self.names else 0.0 for name in (start, end)
            ]
            return (1.0 - t) * of_ends[0] + t * of_ends[1]
        weights = np.abs(self.weights(place))
        shares = [self.materials.unmeasured_share(self.names[k]) for k in np.flatnonzero(weights)]
        return float(weights[weights > 0] @ shares / weights.sum())

    def latent(self, name: str) -> Array:
        """Return the latent of a material, shape (Q,)."""
        return self.X[self.materials.index(name)].copy()

    def between(self, a: str, b: str, t: float) -> Array:
        """Return the latent on the straight line from material a (t = 0) to b (t = 1), shape (Q,)."""
        require_between(t)
        return on_line(self.latent(a), self.latent(b), t)

    def place(self, x: PlaceLike) -> Place:
        """Return the place that a latent or a text denotes."""
        if isinstance(x, Place):
            return x
        if not isinstance(x, str):
            return Place(require_latent(x, self.settings.latent_dim))
        walk = parse_walk(x, self.names)
        if walk is not None:
            start, end, t = walk
            is_end = start == end or t in (0.0, 1.0)  # a material, which lies on the map
            return Place(self.between(start, end, t), None if is_end else walk)
        if x in self.names:
            return Place(self.latent(x))
        coordinates = parse_coordinates(x)
        if coordinates is None:
            raise UnknownNameError(
                f"no material '{x}' in this model ({names_like(self.names, x)}), expected one, or numbers "
                "separated by commas, like -0.3,1.2, or FROM:TO:T between two materials"
            )
        return Place(require_latent(coordinates, self.settings.latent_dim))

    def _is_step(self, x: ArrayLike | PlaceLike, colours: Array | None) -> bool:
        return isinstance(x, Place | str) and self.place(x).is_step(colours)

    def _latents(self, x: ArrayLike | PlaceLike) -> Array:
        if isinstance(x, Place | str):
            return self.place(x).latent
        return require_latents(x, self.settings.latent_dim)

    def _at(
        self,
        x: ArrayLike | PlaceLike,
        colours: Array | None,
        function: Callable[[Array, Array | None], NDArray[S]],
    ) -> NDArray[S]:
        """Apply a function of latents (M, Q) and colours to one latent or several."""
        X, colours = self._latents(x), self.space.require_colours(colours)
        return function(X[None], colours)[0] if X.ndim == 1 else function(X, colours)
