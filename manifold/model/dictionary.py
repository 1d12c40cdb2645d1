"""The dictionary of non-negative least squares: samples, their powers, and lobes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from manifold.analytic.free_lobes import Lobes
from manifold.records import Array


@dataclass(frozen=True)
class Dictionary:
    """Atoms in a mapped domain: the samples cut at 0 to every exponent in turn, then lobes.

    Attributes:
        exponents: of mapped samples; exponents other than 1 make measured lobes broader or narrower.
        lobes: the analytic ones.
    """

    exponents: tuple[float, ...] = (1.0,)
    lobes: Lobes = field(default_factory=Lobes)

    def size(self, n_samples: int) -> int:
        """How many atoms n samples make."""
        return len(self.exponents) * n_samples + len(self.lobes)

    def combine(self, weights: Array, samples: Array, lobes: Array) -> Array:
        """The sum of all atoms by their weights, shape (B, P).

        Args:
            weights: of all atoms, shape (B, n'); those without any are not computed.
            samples, lobes: mapped, shapes (n, P) and (n_l, P).
        """
        combined = weights[:, len(self.exponents) * len(samples) :] @ lobes
        for k, exponent in enumerate(self.exponents):
            part = weights[:, k * len(samples) : (k + 1) * len(samples)]
            used = np.flatnonzero(part.any(axis=0))
            if used.size:
                combined += part[:, used] @ np.maximum(samples[used], 0.0) ** exponent
        return combined
