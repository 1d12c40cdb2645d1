"""The samples of a library used in completion: single bands of its materials, and a Lambertian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from manifold.brdf.gloss import gloss_meter
from manifold.brdf.measured import MeasuredBRDF, all_isotropic
from manifold.colour import ball_colours
from manifold.errors import UsageError
from manifold.library.store import Library
from manifold.mapping import CubeRoot
from manifold.model.appearance import roots_at
from manifold.model.combination import Combination
from manifold.model.materials import MaterialCache
from manifold.model.prediction import PredictedBRDF
from manifold.models.decoder import EncodingPairs
from manifold.models.dictionary import Dictionary
from manifold.models.lobes import Lobes
from manifold.models.nearby import places
from manifold.records import Array, Bands, Progress, evenly_spaced

SAMPLE_BANDS = 5  # of a spectral material; more gain nothing (docs/design/completion.md)
LAMBERTIAN = Dictionary(lobes=Lobes((), ()))
"""The only analytic lobe that samples are combined with."""


@cache
def ball_places() -> Array:
    """Coordinates of the pairs that light a ball, see `nearby.places`."""
    ball = ball_colours.ball()
    return places(ball.wi, ball.wo)


@cache
def grid_places() -> Array:
    """Coordinates of the encoding grid, turned or not, see `nearby.places`."""
    grid = EncodingPairs.default()
    return places(grid.wi, grid.wo)


_BALL_STRIDE = 7  # one in this many of a ball's direction pairs is used


@dataclass(frozen=True, eq=False)
class LibrarySamples:
    """Cube roots of n samples and, last, of a Lambertian on a grid of all directions and on a ball.

    Attributes:
        names: of the materials, N of them.
        bands: of the library.
        sample_bands: which of them are samples, shape (B_s,); sample m * B_s + s is band s of material m.
        materials: in these bands alone.
        directions: cube roots at the encoding grid, then at some pairs that light a ball, shape (n + 1, P).
        weights: of these pairs; grid and ball have the same energy, shape (P,).
        grid: the encoding grid.
        ball: cube roots at all pairs that light a ball, shape (n + 1, P_b).
    """

    names: tuple[str, ...]
    bands: Bands
    sample_bands: Array
    materials: Sequence[MeasuredBRDF]
    directions: Array
    weights: Array
    grid: EncodingPairs
    ball: Array

    @classmethod
    def of_library(cls, library: Library, on_progress: Progress | None = None) -> LibrarySamples:
        """Evaluate all materials of a library, negative values taken for 0. Raises: as `of`."""
        return cls.of(MaterialCache(library, library.names, is_nonnegative=True), on_progress)

    @classmethod
    def of(cls, cache: MaterialCache, on_progress: Progress | None = None) -> LibrarySamples:
        """Evaluate the materials of a cache.

        Raises:
            UsageError: there are fewer than three.
            LibraryError: a material cannot be read.
        """
        count = len(cache.names)
        if count < 3:
            raise UsageError(
                f"{cache.library.path}: {count} material{'s' * (count != 1)}, expected at least three to complete "
                "readings from; import more"
            )
        bands = cache.library.bands
        chosen = evenly_spaced(bands.count, SAMPLE_BANDS)
        materials = cache.in_bands(chosen.tolist(), on_progress)
        grid, ball = EncodingPairs.default(all_isotropic(materials)), ball_colours.ball()
        on_grid, on_ball = (_roots_at(materials, pairs.wi, pairs.wo) for pairs in (grid, ball))
        some = slice(None, None, _BALL_STRIDE)
        on_grid_weights = grid.cosines ** (2.0 / 3.0)
        on_ball_weights = ball.light[some] ** (2.0 / 3.0)
        energy = [
            float(np.sum(roots**2 @ weights))
            for roots, weights in ((on_grid, on_grid_weights), (on_ball[:, some], on_ball_weights))
        ]
        on_ball_weights = on_ball_weights * energy[0] / max(energy[1], np.finfo(float).tiny)
        return cls(
            tuple(cache.names), bands, chosen, materials, np.hstack([on_grid, on_ball[:, some]]),
            np.concatenate([on_grid_weights, on_ball_weights]), grid, on_ball,
        )  # fmt: skip

    @property
    def n_grid(self) -> int:
        """How many pairs are the grid's."""
        return len(self.grid.wi)

    @property
    def per_material(self) -> int:
        """B_s."""
        return len(self.sample_bands)

    @cached_property
    def material_of(self) -> Array:
        """Index of each sample's material, shape (n + 1,); the Lambertian's is N."""
        N = len(self.names)
        return np.append(np.repeat(np.arange(N), self.per_material), N)

    @cached_property
    def gram(self) -> Array:
        """Inner products of samples, averaged over the grid, shape (n + 1, n + 1)."""
        roots, weights = self.directions[:, : self.n_grid], self.weights[: self.n_grid]
        return (roots * weights) @ roots.T / self.n_grid

    def rows(self, materials: Array) -> Array:
        """Indices of the samples of some materials, and of the Lambertian."""
        return np.flatnonzero(np.isin(self.material_of, np.append(materials, len(self.names))))

    def without(self, material: int) -> LibrarySamples:
        """The samples of all other materials."""
        others = np.delete(np.arange(len(self.names)), material)
        rows = self.rows(others)
        left = replace(
            self,
            names=tuple(self.names[int(m)] for m in others),
            materials=[self.materials[int(m)] for m in others],
            directions=self.directions[rows],
            ball=self.ball[rows],
        )
        left.__dict__["gram"] = self.gram[np.ix_(rows, rows)]
        return left

    def at(self, wi: Array, wo: Array) -> Array:
        """Cube roots of samples and Lambertian at direction pairs (P, 3), shape (n + 1, P)."""
        return _roots_at(self.materials, wi, wo)

    def gloss(self, angles_deg: Sequence[float]) -> Array:
        """Cube roots of their means over the apertures of gloss meters at G angles, shape (n + 1, G)."""
        roots = np.empty((len(self.material_of), len(angles_deg)))
        for k, meter in enumerate(map(gloss_meter, angles_deg)):
            roots[:, k] = np.cbrt(meter.mean(self.at(meter.wi, meter.wo).T ** 3))
        return roots

    def predicted(self, weights: Array) -> PredictedBRDF:
        """The BRDF of weights (B, n + 1) of samples in the bands of the library."""
        combination = Combination(CubeRoot(), weights, self.sample_bands, dictionary=LAMBERTIAN)
        return PredictedBRDF(self.materials, combination, self.bands)


def _roots_at(materials: Sequence[MeasuredBRDF], wi: Array, wo: Array) -> Array:
    """Cube roots of samples and, last, of the Lambertian of albedo 1 at direction pairs (P, 3), shape (n + 1, P)."""
    roots = np.ascontiguousarray(roots_at(materials, EncodingPairs(wi, wo)))
    return np.vstack([roots, LAMBERTIAN.lobes.cube_roots(wi, wo)])
