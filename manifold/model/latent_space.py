"""The interface of fitted latent spaces, arrays in and arrays out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from manifold.core.errors import ShapeError, UsageError
from manifold.core.mapping import ValueMapping
from manifold.core.pairs import Pairs
from manifold.core.records import AnyArray, Array, Indices
from manifold.gp.encoding import Decoder, encoding_pairs
from manifold.gp.kernels import Kernel, first_equal_row
from manifold.gpr import GaussianProcess
from manifold.model.combination import Combination
from manifold.model.materials import MaterialCache, MaterialTable
from manifold.model.settings import Settings

Statistics = dict[str, float]
"""Objective at start and end of a fit."""
LeftOutSearch = Callable[[int], tuple[Array, Combination, float]]
"""A function from a left-out material's index to its place (Q,), its prediction, and its residual.

The prediction has weights over all materials.
"""


@dataclass(frozen=True, eq=False)
class Embedded:
    """Latent and colours of a new material, found by embedding.

    Attributes:
        latent: shape (Q,).
        colours: what `Manifold.predict` takes: colour coordinate of every band, shape (B,); of blends also its gain,
            shape (2, B); None of kind `gplvm`.
        relative_error: of the decoded material, `||w (f* - f)|| / ||w f||` on the pairs that it was embedded by.
        residual: of the search, relative: of blends that of cube roots on grid and ball, else `relative_error`.
    """

    latent: Array
    colours: Array | None
    relative_error: float
    residual: float

    def __repr__(self) -> str:
        at = ", ".join(f"{v:.3f}" for v in self.latent)
        coloured = "" if self.colours is None else f", colours of {self.colours.shape[-1]} bands"
        return f"<Embedded: latent ({at}){coloured}, relative error {self.relative_error:.3f}>"


class LatentSpace(ABC):
    """A fitted latent space of N materials.

    Colours that arguments take are checked already, by `require_colours`.

    Attributes:
        X: latents of the materials, shape (N, Q).
        own_colours: colour coordinates of the materials in all bands, shape (N, B), if colours can be chosen.
        reflectances: of the materials at 8 degrees, specular included, shape (N, B), if colours can be chosen.
        landmarks: materials on whose map all others were located, shape (M,); None where all were laid out.
        takes_colours: whether colours can be chosen.
        is_nonnegative: whether negative measured values are taken for 0 where materials are combined.
    """

    kind: ClassVar[str]
    takes_colours: ClassVar[bool] = False
    is_nonnegative: ClassVar[bool] = False
    X: Array
    kernel: Kernel
    landmarks: Indices | None = None
    own_colours: Array
    reflectances: Array

    def __repr__(self) -> str:
        N, Q = self.X.shape
        return f"<{type(self).__name__}: {N} materials, {Q} dimensions, kernel {self.kernel.name}>"

    @cached_property
    def gp(self) -> GaussianProcess:
        """The Gaussian process on the latents: it predicts on a GPLVM, and tells how far the data reach on any map."""
        return GaussianProcess(self.X, self.kernel)

    @property
    def materials_in_words(self) -> str:
        """Return the number of materials, and of landmarks among them, in words."""
        return f"{len(self.X)}" + (
            "" if self.landmarks is None else f", {len(self.landmarks)} of them landmarks"
        )

    @property
    @abstractmethod
    def arrays(self) -> dict[str, AnyArray]:
        """The arrays that a file stores, by name."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, stored: Mapping[str, Array], kernel: Kernel, n_bands: int) -> LatentSpace:
        """Restore the space from a file's arrays."""

    def printed(self, x: Array) -> tuple[str, ...]:
        """Return the coordinates of a latent (Q,) with the digits that reproduce its prediction."""
        return tuple(repr(float(v)) for v in x)

    def numbers(self, n_bands: int) -> int:
        """Return how many numbers describe a material of `n_bands` bands: its latent, and colours and gains."""
        return self.X.shape[1] + 2 * n_bands * self.takes_colours

    def around(self, x: Array) -> tuple[Indices, LatentSpace] | None:
        """Return the materials that predictions at x (Q,) depend on, (n,), and their space; None if all may matter."""
        return None

    @abstractmethod
    def weights(self, x: Array, colours: Array | None) -> Array:
        """Return the weights of a prediction at x (Q,): of materials (N,), or of samples in every band (B, n)."""

    @abstractmethod
    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Return the materials' weights at latents X (M, Q), shape (M, N).

        They are summed over a material's samples and averaged over bands.
        """

    def require_colours(self, colours: Array | None) -> Array | None:
        """Return colours as float64: (B,), or with gains (2, B). Raises ShapeError if they are no such colours."""
        if colours is None:
            return None
        if not self.takes_colours:
            raise UsageError(fixed_colours(self.kind))
        colours = np.asarray(colours, dtype=np.float64)
        n_bands = self.reflectances.shape[1]
        expected = [(n_bands,), (2, n_bands)]
        if colours.shape not in expected:
            shapes = " or ".join(map(str, expected))
            raise ShapeError(f"colours have shape {colours.shape}, expected {shapes}")
        for bad, what in ((~np.isfinite(colours), "not finite"), (colours < 0.0, "negative")):
            if np.any(bad):
                raise ShapeError(
                    f"{np.count_nonzero(bad)} of {colours.size} values of colours are {what}, expected at least 0, "
                    "as colours.of_reflectance returns"
                )
        return colours

    @abstractmethod
    def embedding_bands(self, n_bands: int) -> Indices:
        """Return the bands whose values are compared to find a latent."""

    def samples(self, mapped: Array, cosines: Array) -> tuple[Array, Array]:
        """Reshape mapped values (N, B_e, P) to training samples (n, P'), and cosines (P,) to (P',).

        By default a row holds one embedding band of a material.
        """
        return mapped.reshape(-1, mapped.shape[2]), cosines

    def embedding_pairs(self, is_isotropic: bool = True) -> Pairs:
        """Return the direction pairs at which new isotropic or anisotropic materials are compared with predictions."""
        return encoding_pairs(is_isotropic)

    @abstractmethod
    def embed(self, decoder: Decoder, f: Array, settings: Settings) -> Embedded:
        """Return the latent of a material with values f (B, P) in all bands.

        The decoder holds all embedding bands.
        """

    @abstractmethod
    def left_out_search(
        self, table: MaterialTable, materials: MaterialCache, settings: Settings
    ) -> LeftOutSearch:
        """Return a search for the place of each material among the others, which keep their places."""

    def combination(self, x: Array, colours: Array | None, mapping: ValueMapping) -> Combination:
        """Return the weighted sum of a prediction at a latent x (Q,); at a training latent, only that material."""
        k = self.training_index(x, colours)
        if k is not None:
            return Combination(mapping, np.eye(len(self.X))[k])
        return Combination(mapping, self.weights(x, colours))

    def training_index(self, x: Array, colours: Array | None) -> int | None:
        """Return the material whose latent x (Q,) and colours (B,) these are."""
        k = int(first_equal_row(x[None], self.X)[0])
        return k if k >= 0 else None

    def training_indices(self, X: Array, colours: Array | None) -> Indices:
        """Return the material at each of the latents X (M, Q) with these colours (B,), or -1, shape (M,)."""
        found = first_equal_row(X, self.X)
        for m in np.flatnonzero(found >= 0):
            index = self.training_index(X[m], colours)
            found[m] = -1 if index is None else index
        return found

    def variance_fraction(self, X: Array, colours: Array | None) -> Array:
        """Return posterior over prior variance at X (M, Q), shape (M,); 0 at a material."""
        return np.where(self.training_indices(X, colours) < 0, self.gp.variance_fraction(X), 0.0)


def fixed_colours(kind: str) -> str:
    """Return the reason why no colour can be chosen, and the remedy."""
    return f"colours cannot be chosen on a manifold of kind {kind}; leave the colour out, or embed with kind blend"


def require_shapes(stored: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]) -> list[Array]:
    """Return the arrays of a file with these names. Raises ValueError unless they have these shapes."""
    for name, shape in shapes.items():
        if stored[name].shape != shape:
            raise ValueError(f"dataset '{name}' has shape {stored[name].shape}, expected {shape}")
    return [stored[name] for name in shapes]


def require_bands(stored: Mapping[str, Array], n_bands: int) -> Indices:
    """Return band indices of a file as integers. Raises ValueError unless they increase and these bands exist."""
    bands = stored["bands"].astype(np.int64)
    if not np.all(np.diff(bands) > 0) or bands.min() < 0 or bands.max() >= n_bands:
        raise ValueError(f"dataset 'bands' holds {bands.tolist()}, expected increasing bands")
    return bands
