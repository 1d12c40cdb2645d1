"""What is known of a material: linear functionals of its BRDF, or of its cube roots, and what was seen of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from manifold.records import Array, Mask

LEAST = 216.0 / 24389.0
"""Of display white: CIELAB is linear below."""


@dataclass(frozen=True, eq=False)
class Observation:
    """R linear functionals of a material in one band, and what was seen of them.

    Values at direction pairs, pixels of a ball or of a photograph, and means over the aperture of a gloss meter are all
    such rows; they may be given together.

    Attributes:
        atoms: the functionals of n atoms, shape (n, R).
        seen: what they were seen to be, shape (R,).
        weights: how much the squared error of each counts, shape (R,).
        is_bound: the material was at least as bright as seen, since the camera clipped it, shape (R,).
        is_root: the rows are functionals of cube roots of the BRDF.
        n_beside: how many of the rows, the last ones, stand beside a camera's pixels, see `beside`.
    """

    atoms: Array
    seen: Array
    weights: Array
    is_bound: Mask
    is_root: bool = False
    n_beside: int = 0

    @classmethod
    def joined(cls, parts: Sequence[Observation]) -> Observation:
        """Rows of several sources together."""
        seen, weights, bounds = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("seen", "weights", "is_bound")
        )
        return cls(np.concatenate([part.atoms for part in parts], axis=1), seen, weights, bounds)

    def beside(self, other: Observation) -> Observation:
        """The same pixels, and rows of another source: these are never clipped, and do not choose the prior."""
        n_beside = self.n_beside + len(other.seen)
        return replace(Observation.joined([self, other]), n_beside=n_beside)

    @property
    def pixels(self) -> Observation:
        """The rows that stand beside nothing."""
        n = len(self.seen) - self.n_beside
        return Observation(self.atoms[:, :n], self.seen[:n], self.weights[:n], self.is_bound[:n])

    def scaled(self, exposure: float) -> Observation:
        """The same for what was seen under an exposure."""
        return replace(self, seen=self.seen / exposure)

    @property
    def relative(self) -> Observation:
        """The same with weights by which squared errors of cube roots are relative to what was seen."""
        norm = float(self.weights @ np.maximum(self.seen, 0.0) ** (2.0 / 3.0))
        return replace(self, weights=self.weights / max(norm, LEAST * float(self.weights.sum())))

    def slopes(self, fitted: Array) -> Array:
        """By what to multiply errors of rows, fitted so far (R,), so that they are those of cube roots: (R,).

        Cube roots are linear below 0.9 % of display white, as in CIELAB. Bounds that hold do not count.
        """
        counts = np.sqrt(np.where(self.is_bound & (fitted >= self.seen), 0.0, self.weights))
        if self.is_root:
            return counts
        a, b = np.cbrt(np.maximum(self.seen, 0.0)), np.cbrt(np.maximum(fitted, 0.0))
        return np.asarray(counts / np.maximum(a * a + a * b + b * b, 3.0 * LEAST ** (2.0 / 3.0)))

    def error(self, weights: Array) -> float:
        """Root of the weighted squared error of cube roots that weights (n,) of atoms leave."""
        fitted = weights @ self.atoms
        return float(np.linalg.norm((fitted - self.seen) * self.slopes(fitted)))
