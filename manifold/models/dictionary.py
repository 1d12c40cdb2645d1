"""The dictionary of non-negative least squares: samples, their powers, and lobes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from manifold.models.lobes import Lobes
from manifold.records import Array


@dataclass(frozen=True)
class Dictionary:
    """Atoms, all as cube roots of f: the samples cut at 0 to every exponent in turn, then lobes.

    Attributes:
        exponents: of the cube roots of samples; exponents other than 1 make measured lobes broader or narrower.
        lobes: the analytic ones.
    """

    exponents: tuple[float, ...] = (1.0,)
    lobes: Lobes = field(default_factory=Lobes)

    def size(self, n_samples: int) -> int:
        """How many atoms n samples make."""
        return len(self.exponents) * n_samples + len(self.lobes)

    def atoms(self, roots: Array, lobe_roots: Array) -> Array:
        """All atoms (n', P), of the cube roots of samples (n, P) and lobes (n_l, P)."""
        return np.vstack([*(np.maximum(roots, 0.0) ** q for q in self.exponents), lobe_roots])

    def combine(self, weights: Array, roots: Array, lobe_roots: Array) -> Array:
        """`weights @ atoms(roots, lobe_roots)`, shape (B, P), without the atoms that have no weight.

        Args:
            weights: shape (B, n').
            roots, lobe_roots: see `atoms`.
        """
        combined = weights[:, len(self.exponents) * len(roots) :] @ lobe_roots
        for k, exponent in enumerate(self.exponents):
            part = weights[:, k * len(roots) : (k + 1) * len(roots)]
            used = np.flatnonzero(part.any(axis=0))
            if used.size:
                combined += part[:, used] @ np.maximum(roots[used], 0.0) ** exponent
        return combined
