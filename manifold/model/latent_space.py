"""The interface of fitted latent spaces, arrays in and arrays out.

- `BlendSpace` (kind `blend`): a material is one point, and weights are non-negative. Colours can be chosen.
- `MaterialSpace` (kind `material`): a material is one point of a Gaussian process, with the same weights in all bands.
- `CurveSpace` (kind `monochrome`): every band of a material is a point of a Gaussian process. Its structure coordinates
  are the material's, its colour coordinate is its own, and so are its weights of the samples, a few bands of each
  material.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from collections.abc import Mapping as Fields
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from manifold.errors import ShapeError, UsageError
from manifold.mapping import Mapping
from manifold.model.combination import Combination
from manifold.models.colour_table import ColourTable
from manifold.models.decoder import Decoder, EncodingPairs
from manifold.models.encoder import Encoder
from manifold.models.gp_weights import GPWeights
from manifold.models.kernels import Kernel, first_equal_row
from manifold.records import Array

if TYPE_CHECKING:
    from manifold.model.blend_space import BlendSpace
    from manifold.model.material_table import MaterialTable
    from manifold.model.materials import MaterialCache
    from manifold.model.settings import Settings

LeftOutSearch = Callable[[int], tuple[Array, Combination]]
"""From the index of a left-out material to its place (Q,) and its prediction there, with weights over all materials."""


@dataclass(frozen=True, eq=False)
class Embedded:
    """Latent and colours of a new material, found by embedding.

    Attributes:
        latent: shape (Q,).
        colours: what `Manifold.predict` takes: colour coordinate of every band, shape (B,); of blends also its gain,
            shape (2, B); None of kind `material`.
        relative_error: of the decoded material, `||w (f* - f)|| / ||w f||` on the pairs that it was embedded by.
    """

    latent: Array
    colours: Array | None
    relative_error: float


class LatentSpace(ABC):
    """A fitted latent space of N materials.

    Attributes:
        X: latents of the materials, shape (N, Q); of a `CurveSpace` their structure coordinates.
        kernel: covariance function on the latents.
        sample_bands: bands of the materials that predictions combine, shape (B_s,); None is all of them.
        kind: its name.
        takes_colours: whether colours can be chosen.
        needs_colours: whether a prediction needs them.
        is_nonnegative: whether negative measured values are taken for 0 where materials are combined.
    """

    kind: ClassVar[str]
    takes_colours: ClassVar[bool]
    needs_colours: ClassVar[bool] = False
    is_nonnegative: ClassVar[bool] = False
    X: Array
    kernel: Kernel
    sample_bands: Array | None

    def __repr__(self) -> str:
        N, Q = self.X.shape
        return f"<{type(self).__name__}: {N} materials, {Q} dimensions, kernel {self.kernel.name}>"

    @cached_property
    def gp(self) -> GPWeights:
        """The Gaussian process of the training samples."""
        return GPWeights(self.latents_of(np.arange(len(self.X))), self.kernel)

    @property
    @abstractmethod
    def arrays(self) -> dict[str, Array]:
        """The arrays that a file stores, by name."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel, n_bands: int) -> LatentSpace:
        """The space of a file's arrays.

        Raises:
            ValueError: the arrays do not fit each other, or the number of bands.
        """

    def printed(self, x: Array) -> tuple[str, ...]:
        """Coordinates of a latent (Q,) with the digits that reproduce its prediction."""
        return tuple(repr(float(v)) for v in x)

    @abstractmethod
    def numbers(self, n_bands: int) -> int:
        """How many numbers describe a material of `n_bands` bands."""

    def sample_rows(self, materials: Array) -> Array:
        """Indices of the training samples of some materials; by default a material is one sample."""
        return materials

    def latents_of(self, materials: Array) -> Array:
        """Latents of the training samples of some materials, shape (n, Q')."""
        return self.X[materials]

    def own_latents(self, material: int) -> Array:
        """Latents of one material: one, or one per band, shape (1 or B, Q')."""
        return self.X[material : material + 1]

    @abstractmethod
    def join(self, X: Array, colours: Array | None) -> Array:
        """Latents (M R, Q') of the process at X (M, Q), in colours (B,) or those of surrounding materials."""

    @abstractmethod
    def weights(self, x: Array, colours: Array | None) -> Array:
        """Weights of a prediction at x (Q,): of materials (N,), or of samples in every band (B, n)."""

    @abstractmethod
    def material_weights(self, X: Array, colours: Array | None) -> Array:
        """Weights at latents X (M, Q) summed over the samples of a material, averaged over bands, shape (M, N)."""

    @abstractmethod
    def colour_table(self) -> tuple[Array, Array]:
        """Colour coordinates and reflectances of the materials in all bands, shape (N, B) each.

        Raises:
            UsageError: whole materials have fixed colours.
        """

    @abstractmethod
    def require_colours(self, colours: Array | None) -> Array | None:
        """Colours (B,) as float64.

        Raises:
            UsageError: colours are given, but fixed by the latents.
            ShapeError: they are not (B,) or not finite.
        """

    @abstractmethod
    def embedding_bands(self, n_bands: int) -> Array:
        """Bands whose values are compared to find a latent."""

    @abstractmethod
    def samples(self, mapped: Array, cosines: Array) -> tuple[Array, Array]:
        """Training samples (n, P') from mapped values (N, B_e, P) in the embedding bands, and cosines (P,) as (P',)."""

    def embedding_pairs(self, is_isotropic: bool = True) -> EncodingPairs:
        """Direction pairs at which a new material is compared with what the space predicts.

        Args:
            is_isotropic: whether both are.
        """
        return EncodingPairs.default(is_isotropic)

    @abstractmethod
    def embed(self, encoder: Encoder, f: Array) -> Embedded:
        """The latent of a material with values f (B, P) in all bands."""

    @abstractmethod
    def left_out_search(
        self, table: MaterialTable, materials: MaterialCache, settings: Settings
    ) -> LeftOutSearch:
        """A search for the place of each material among the others, whose places are kept."""

    def require_blends(self) -> BlendSpace:
        """The space of a map of blends.

        Raises:
            UsageError: the map is of another kind.
        """
        raise UsageError(f"a map of kind {self.kind}, expected blend: embed with --kind blend")

    def combination(self, x: Array, colours: Array | None, mapping: Mapping) -> Combination:
        """The weighted sum of a prediction at a latent x (Q,); at a training latent, that material alone."""
        k = self.training_index(x, colours)
        if k is not None:
            return Combination(mapping, np.eye(len(self.X))[k])
        return Combination(mapping, self.weights(x, colours), self.sample_bands)

    def reflectance_of(self, x: Array, colours: Array, decoder: Decoder, measure: Array) -> Array:
        """Reflectance (B,) of a structure x (Q,) in colours (B,), by a measure (P,) of the decoder's outputs."""
        return decoder.decode(self.join(x[None], colours)) @ measure

    def colours_of(
        self, x: Array, reflectance: Array, decoder: Decoder, measure: Array
    ) -> tuple[Array, Array]:
        """Colours (B,) in which a structure x (Q,) has a reflectance (B,), and the reflectance reached, (B,)."""
        return ColourTable(decoder, x).of_albedo(reflectance, measure)

    def training_index(self, x: Array, colours: Array | None) -> int | None:
        """The material whose latent x (Q,) and colours (B,) these are."""
        k = int(first_equal_row(x[None], self.X)[0])
        return k if k >= 0 else None

    def training_indices(self, X: Array, colours: Array | None) -> Array:
        """The material that each of the latents X (M, Q) with these colours (B,) is, or -1, shape (M,)."""
        found = first_equal_row(X, self.X)
        for m in np.flatnonzero(found >= 0):
            index = self.training_index(X[m], colours)
            found[m] = -1 if index is None else index
        return found

    def variance_fraction(self, X: Array, colours: Array | None) -> Array:
        """Posterior over prior variance at X (M, Q), averaged over bands, shape (M,); 0 at a material."""
        found = self.gp.variance_fraction(self.join(X, colours)).reshape(len(X), -1).mean(axis=1)
        return np.where(self.training_indices(X, colours) < 0, found, 0.0)


def require_shape(name: str, found: Any, shape: tuple[int, ...]) -> None:
    """Raise ValueError unless an array of a file has a shape."""
    if np.shape(found) != shape:
        raise ValueError(f"dataset '{name}' has shape {np.shape(found)}, expected {shape}")


def require_bands(name: str, found: Array, n_bands: int) -> Array:
    """Band indices of a file, as integers. Raises ValueError unless they increase and there are such bands."""
    bands = found.astype(np.int64)
    if not np.all(np.diff(bands) > 0) or bands.min() < 0 or bands.max() >= n_bands:
        raise ValueError(f"dataset '{name}' holds {bands.tolist()}, expected increasing bands")
    return bands


def checked_colours(colours: Array | None, *shapes: tuple[int, ...]) -> Array | None:
    """Colours as float64. Raises ShapeError unless they have one of the shapes and are finite."""
    if colours is None:
        return None
    colours = np.asarray(colours, dtype=np.float64)
    if colours.shape not in shapes or not np.all(np.isfinite(colours)):
        expected = " or ".join(map(str, shapes))
        raise ShapeError(f"colours have shape {colours.shape}, expected {expected}, finite")
    return colours
