"""The interface of fitted latent spaces."""

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
"""Statistics of a fit by name, such as the objective at its start and end."""
LeftOutSearch = Callable[[int], tuple[Array, Combination, float]]
"""A function that leaves out a material, by its index; it returns its latent (Q,), prediction, and residual.

The weights of the prediction cover all materials.
"""


@dataclass(frozen=True, eq=False)
class Embedded:
    """The latent and the colours that embedding found for a new material.

    Attributes:
        latent: latent, shape (Q,).
        colours: colours for `Manifold.predict`: colour coordinate of every band, shape (B,), or for blends also its
            gain, shape (2, B); None for kind `gplvm`.
        relative_error: error of the decoded material, `||w (f* - f)|| / ||w f||`, on the direction pairs of the
            search.
        residual: relative residual of the search; for blends the residual of cube roots on grid and ball, otherwise
            `relative_error`.
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

    Methods take colours that `require_colours` has checked.

    Attributes:
        X: latents of the materials, shape (N, Q).
        own_colours: colour coordinates of the materials in all bands, shape (N, B), if colours can be given.
        reflectances: reflectances of the materials at 8 degrees, specular included, shape (N, B), if colours can be
            given.
        landmarks: indices of the materials on whose map all others were located, shape (M,); None if all materials
            were laid out together.
        takes_colours: whether colours can be given.
        is_nonnegative: whether negative measured values are treated as 0 when materials are combined.
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
        """Return the Gaussian process on the latents.

        Its variance shows how far predictions are supported by the data.
        """
        return GaussianProcess(self.X, self.kernel)

    @property
    def materials_in_words(self) -> str:
        """Return a text with the number of materials and, if there are any, of landmarks."""
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
        """Return the coordinates of a latent (Q,) as text, with the digits that reproduce its prediction."""
        return tuple(repr(float(v)) for v in x)

    def numbers(self, n_bands: int) -> int:
        """Return the number of parameters of a material with `n_bands` bands: its latent, colours and gains."""
        return self.X.shape[1] + 2 * n_bands * self.takes_colours

    def around(self, x: Array) -> tuple[Indices, LatentSpace] | None:
        """Return the indices (n,) of the materials on which predictions at x (Q,) depend, and the space of these alone.

        Returns None if predictions may depend on all materials.
        """
        return None

    @abstractmethod
    def weights(self, x: Array, colours: Array | None) -> Array:
        """Return the weights at x (Q,): of materials, (N,), or with given colours, of samples in every band, (B, n)."""

    @abstractmethod
    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Return the weights of the materials at latents X (M, Q), shape (M, N).

        Weights of samples are summed over the samples of a material and averaged over the bands.
        """

    def require_colours(self, colours: Array | None) -> Array | None:
        """Return colours as float64, shape (B,) or with gains (2, B). Raises ShapeError for invalid ones."""
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
        """Return the indices of the bands whose values are compared to locate a material."""

    def samples(self, mapped: Array, cosines: Array) -> tuple[Array, Array]:
        """Reshape mapped values (N, B_e, P) to training samples (n, P'), and cosines (P,) to (P',).

        By default a training sample is one embedding band of a material.
        """
        return mapped.reshape(-1, mapped.shape[2]), cosines

    def embedding_pairs(self, is_isotropic: bool = True) -> Pairs:
        """Return the direction pairs at which new materials are compared with predictions."""
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
        """Return a function that locates each material among the others, whose latents stay fixed."""

    def combination(self, x: Array, colours: Array | None, mapping: ValueMapping) -> Combination:
        """Return the materials and weights that predict at a latent x (Q,); at `training_index`, only that material."""
        k = self.training_index(x, colours)
        if k is not None:
            return Combination(mapping, np.eye(len(self.X))[k])
        return Combination(mapping, self.weights(x, colours))

    def training_index(self, x: Array, colours: Array | None) -> int | None:
        """Return the index of the material with this latent x (Q,) and these colours (B,), otherwise None."""
        k = int(first_equal_row(x[None], self.X)[0])
        return k if k >= 0 else None

    def training_indices(self, X: Array, colours: Array | None) -> Indices:
        """Return the index of the material at each latent X (M, Q) with these colours (B,), or -1, shape (M,)."""
        found = first_equal_row(X, self.X)
        for m in np.flatnonzero(found >= 0):
            index = self.training_index(X[m], colours)
            found[m] = -1 if index is None else index
        return found

    def variance_fraction(self, X: Array, colours: Array | None) -> Array:
        """Return the posterior over the prior variance at latents X (M, Q), shape (M,); it is 0 at a material."""
        return np.where(self.training_indices(X, colours) < 0, self.gp.variance_fraction(X), 0.0)


def fixed_colours(kind: str) -> str:
    """Return a message that explains why no colour can be given for a kind of model, and what to do."""
    return f"colours cannot be given for a manifold of kind {kind}; leave the colour out, or embed with kind blend"


def require_shapes(stored: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]) -> list[Array]:
    """Return the arrays of a file with these names. Raises ValueError unless they have the expected shapes."""
    for name, shape in shapes.items():
        if stored[name].shape != shape:
            raise ValueError(f"dataset '{name}' has shape {stored[name].shape}, expected {shape}")
    return [stored[name] for name in shapes]


def require_bands(stored: Mapping[str, Array], n_bands: int) -> Indices:
    """Return the band indices of a file as integers. Raises ValueError unless they increase and these bands exist."""
    bands = stored["bands"].astype(np.int64)
    if not np.all(np.diff(bands) > 0) or bands.min() < 0 or bands.max() >= n_bands:
        raise ValueError(f"dataset 'bands' holds {bands.tolist()}, expected increasing bands")
    return bands
