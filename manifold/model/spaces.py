"""Fitted latent spaces, arrays in and arrays out: whole materials as points, and materials as curves.

In a `MaterialSpace` a material is one point, and one set of weights serves all bands. In a `CurveSpace` every
band is a point: its structure coordinates are the material's, its colour coordinate is its own, and every
band has weights over the monochrome samples, a few bands of each material.
"""

from __future__ import annotations

from collections.abc import Mapping as Fields
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from manifold.gpr import GPWeights
from manifold.models.kernels import Kernel
from manifold.models.per_band import join_latents
from manifold.records import Array

KINDS = ("monochrome", "material")


@dataclass(frozen=True, eq=False)
class MaterialSpace:
    """Whole materials as points, the kind of Hikichi & Iwasaki.

    Attributes:
        X: latents, shape (N, Q).
        S: Gram matrix of the mapped materials, not centred, shape (N, N).
        n_outputs: D, the outputs behind S.
        kernel: the covariance function.
    """

    X: Array
    S: Array
    n_outputs: int
    kernel: Kernel

    @cached_property
    def gp(self) -> GPWeights:
        """The Gaussian process of the latents."""
        return GPWeights(self.X, self.kernel)

    @property
    def arrays(self) -> dict[str, Array]:
        """What a file has to hold."""
        return {"X": self.X, "S": self.S, "n_outputs": np.array(self.n_outputs)}

    @classmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel) -> MaterialSpace:
        """The same space again.

        Raises:
            ValueError: the arrays do not fit each other.
        """
        X, S = stored["X"], stored["S"]
        _require_shape("S", S, (len(X), len(X)))
        if stored["n_outputs"].shape != () or not stored["n_outputs"] >= 1:
            raise ValueError(f"dataset 'n_outputs' holds {stored['n_outputs']}, expected a count")
        return cls(X, S, int(stored["n_outputs"]), kernel)


@dataclass(frozen=True, eq=False)
class CurveSpace:
    """Materials as curves over their bands: structure is shared by the bands, colour is a band's own.

    Attributes:
        X: structure coordinates, shape (N, Q).
        sample_colours: colour coordinates of the monochrome samples, shape (N, B_s).
        sample_bands: which bands they are, increasing, shape (B_s,).
        colours: colour coordinates of all bands, shape (N, B).
        reflectances: of the materials at 8 degrees, specular included, shape (N, B): what a colour means to people.
        kernel: the covariance function.
    """

    X: Array
    sample_colours: Array
    sample_bands: Array
    colours: Array
    reflectances: Array
    kernel: Kernel

    @cached_property
    def gp(self) -> GPWeights:
        """The Gaussian process of the samples, structure first, colour last."""
        return GPWeights(self.join(self.X, self.sample_colours), self.kernel)

    def join(self, x: Array, colours: Array) -> Array:
        """Latents (M B, Q + 1) of structures x (M, Q) in colours (M, B)."""
        return join_latents(x, colours[:, :, None]).reshape(-1, x.shape[1] + 1)

    @property
    def arrays(self) -> dict[str, Array]:
        """What a file has to hold."""
        return {
            "X": self.X,
            "sample_colours": self.sample_colours,
            "sample_bands": self.sample_bands,
            "colours": self.colours,
            "reflectances": self.reflectances,
        }

    @classmethod
    def from_arrays(cls, stored: Fields[str, Array], kernel: Kernel) -> CurveSpace:
        """The same space again.

        Raises:
            ValueError: the arrays do not fit each other.
        """
        X, bands = stored["X"], stored["sample_bands"].astype(np.int64)
        colours = stored["colours"]
        _require_shape("sample_colours", stored["sample_colours"], (len(X), len(bands)))
        _require_shape("colours", colours, (len(X), colours.shape[-1]))
        _require_shape("reflectances", stored["reflectances"], colours.shape)
        if not np.all(np.diff(bands) > 0) or bands.min() < 0 or bands.max() >= colours.shape[1]:
            raise ValueError(f"dataset 'sample_bands' holds {bands.tolist()}, expected increasing bands")
        return cls(X, stored["sample_colours"], bands, colours, stored["reflectances"], kernel)


def _require_shape(name: str, found: Any, shape: tuple[int, ...]) -> None:
    if np.shape(found) != shape:
        raise ValueError(f"dataset '{name}' has shape {np.shape(found)}, expected {shape}")
