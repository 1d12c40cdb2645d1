"""Tabulates all materials at the direction pairs from which methods learn, and computes Gram matrices."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.core import progress
from manifold.core.mapping import ValueMapping
from manifold.core.metrics import relative_error
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, Indices, evenly_spaced
from manifold.gp.encoding import PAIR_STRIDE
from manifold.model import gram
from manifold.model.combination import Values
from manifold.model.settings import LEARNT_BANDS

_BLOCK_VALUES = 10_000_000  # measured values held at once, of all materials together


@dataclass(frozen=True, eq=False)
class Data(Values):
    """The data of methods: values of N materials at P direction pairs, in B' of their B bands.

    Attributes:
        f: values in 1/sr, shape (N, P, B').
        bands: increasing indices of the B' bands among all bands; by default all.
        n_bands: number B of all bands.
        stride: stride over the direction pairs in searches for a latent by decoded values.
        materials: the evaluated materials, for methods that need other direction pairs.
    """

    bands: Indices = field(default=None)  # type: ignore[arg-type]
    n_bands: int = 0
    stride: int = PAIR_STRIDE
    materials: Sequence[MeasuredBRDF] = field(default=(), repr=False)
    _made: dict[Hashable, Any] = field(default_factory=dict, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.bands is None:
            object.__setattr__(self, "bands", np.arange(self.f.shape[2]))
            object.__setattr__(self, "n_bands", self.f.shape[2])

    @classmethod
    def evaluate(
        cls,
        materials: Sequence[MeasuredBRDF],
        grid: RusinkiewiczGrid,
        bands: Indices | None = None,
        *,
        stride: int = PAIR_STRIDE,
    ) -> Data:
        """Evaluate N materials with the same bands at the direction pairs of a grid.

        `bands` holds the increasing indices of the bands to evaluate; by default, at most `LEARNT_BANDS` evenly spaced
        ones.
        """
        n_bands = materials[0].bands.count
        bands = evenly_spaced(n_bands, LEARNT_BANDS) if bands is None else bands
        selected = [material.select_bands(bands.tolist()) for material in materials]
        blocks = []
        total = -(-grid.n_pairs // gram.BLOCK_PAIRS)
        for block in gram.value_blocks(selected, grid):
            blocks.append(block)
            progress.report(len(blocks), total, "direction pairs")
        wi, wo, f = zip(*blocks, strict=True)
        return cls(
            np.concatenate(f, axis=1),
            np.concatenate(wi),
            np.concatenate(wo),
            bands,
            n_bands,
            stride,
            materials,
        )

    def blocks(self) -> Iterator[Values]:
        """Yield the values in blocks of direction pairs."""
        size = block_pairs(self.n_materials, len(self.bands))
        for start in range(0, self.f.shape[1], size):
            some = slice(start, start + size)
            yield Values(self.f[:, some], self.wi[some], self.wo[some])

    def cached(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the cached result of `make` for a key."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def unmapped(self) -> Data:
        """Return the data without cached products, so that each method pays for its own."""
        return Data(self.f, self.wi, self.wo, self.bands, self.n_bands, self.stride, self.materials)

    @property
    def n_materials(self) -> int:
        """Number of materials, N."""
        return len(self.f)

    @property
    def n_outputs(self) -> int:
        """D, the number of direction pairs times the number of bands."""
        return self.f.shape[1] * self.f.shape[2]

    def gram(self, mapping: ValueMapping, bands: Indices | None = None, *, power: float = 1.0) -> Array:
        """Return the inner products of samples, summed over direction pairs with weights cosines^power and over bands.

        Samples are whole materials, shape (N, N), or single bands, shape (N * B_s, N * B_s).
        """

        def products() -> Array:
            weight = np.sqrt(self.cosines**power)
            flat = self.samples(mapping, bands) * (
                np.repeat(weight, self.f.shape[2]) if bands is None else weight
            )
            return flat @ flat.T

        return self.cached((mapping, power, None if bands is None else tuple(bands.tolist())), products)

    def samples(self, mapping: ValueMapping, bands: Indices | None = None) -> Array:
        """Return T(f), sample by sample: whole materials, shape (N, P * B'), or single bands, shape (N * B_s, P).

        `bands` (B_s,) are indices among all bands.
        """
        if bands is None:
            return self.mapped(mapping).reshape(self.n_materials, -1)
        return self.mapped_samples(mapping, np.searchsorted(self.bands, bands))

    def available_bands(self, count: int) -> Indices:
        """Return at most `count` of the tabulated bands, as evenly spaced over all bands as possible."""
        wanted = evenly_spaced(self.n_bands, count)
        nearest = np.abs(self.bands[None] - wanted[:, None]).argmin(axis=1)
        return np.unique(self.bands[nearest])

    def relative_error(self, i: int, predicted: Array) -> float:
        """Return the error of a prediction (P, B') of material i, weighted by the cosines."""
        return relative_error(self.f[i], predicted, self.cosines)


def band_shares(bands: Indices, n_bands: int) -> Array:
    """Return, for each of the increasing bands (B',), the number of all bands that are nearest to it, shape (B',)."""
    edges = np.concatenate([[-0.5], 0.5 * (bands[1:] + bands[:-1]), [n_bands - 0.5]])
    return np.diff(edges)


def block_pairs(n_materials: int, n_bands: int) -> int:
    """Return the number of direction pairs in a block of values."""
    return int(np.clip(_BLOCK_VALUES // (n_materials * n_bands), 64, 16384))
