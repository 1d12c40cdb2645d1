"""The settings of a fit, one class per kind of manifold."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any, ClassVar, Self

from manifold.core.defaults import (
    DEFAULT_GRID,
    DEFAULT_KERNEL,
    DEFAULT_LENGTH_SCALE,
    DEFAULT_MAPPING,
    DEFAULT_MU,
    DEFAULT_OPTIMIZER,
    DEFAULT_PRIOR,
    LANDMARKS,
    MOST_LAID_OUT,
)
from manifold.core.errors import UsageError
from manifold.core.pairs import RusinkiewiczGrid
from manifold.gp.kernels import Kernel, kernel_named, require_mu
from manifold.gp.likelihood import require_prior
from manifold.registries import MAPPINGS, OPTIMIZERS

SAMPLE_BANDS = 5
"""Largest number of bands per material that are samples or atoms: in colour paths, reconstructions and completions."""
COMPARED_BANDS, LEARNT_BANDS = 12, 20
"""Largest numbers of bands, evenly spaced, in which materials are compared, and which methods learn from."""


@dataclass(frozen=True)
class Settings(ABC):
    """The settings with which a manifold is fitted; the base class of `BlendSettings` and `GplvmSettings`.

    Attributes:
        latent_dim: Q, the number of latent dimensions.
        length_scale: l, in units of the latents.
        kind: the kind of manifold.
    """

    latent_dim: int = 2
    length_scale: float = field(default=DEFAULT_LENGTH_SCALE, kw_only=True)
    kind: ClassVar[str]

    def __new__(cls, *args: Any, **options: Any) -> Self:
        """Raise UsageError for settings of no kind."""
        if cls is Settings:
            raise UsageError("Settings is abstract; use BlendSettings or GplvmSettings")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        _require_whole("latent_dim", self.latent_dim, 1)
        self.covariance()  # checks it

    @property
    @abstractmethod
    def mapping(self) -> str:
        """The name of the mapping."""

    @abstractmethod
    def covariance(self) -> Kernel:
        """Return the kernel with its parameters."""

    @property
    def fills_cells(self) -> bool:
        """Return whether unmeasured cells are filled; they are zeros in the published method."""
        return True

    def to_json(self) -> dict[str, Any]:
        """Return the settings as plain values, as a model file holds them."""
        return {"kind": self.kind, "mapping": self.mapping, **vars(self)}


@dataclass(frozen=True)
class BlendSettings(Settings):
    """The settings of a map of blends, where every point is a non-negative combination of the cube roots of materials.

    It also has the attributes of `Settings`.

    Attributes:
        sample_bands: largest number of bands per material from which colours are mixed.
        landmarks: number of materials that are laid out together; the others are located among them. None lays out up
            to 300 materials together, and uses 150 landmarks for more.
    """

    sample_bands: int = SAMPLE_BANDS
    landmarks: int | None = None
    kind: ClassVar[str] = "blend"

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_whole("sample_bands", self.sample_bands, 2)
        if self.landmarks is not None and self.landmarks <= self.latent_dim + 1:
            raise UsageError(
                f"landmarks = {self.landmarks} in {self.latent_dim} dimensions, expected at least "
                f"{self.latent_dim + 2}"
            )

    @property
    def mapping(self) -> str:
        """The name of the mapping."""
        return "cube-root"

    def covariance(self) -> Kernel:
        """Return the kernel that determines how far from the materials predictions are supported."""
        return kernel_named("se", length_scale=self.length_scale)

    def landmarks_of(self, materials: int) -> int:
        """Return how many of `materials` materials are laid out as landmarks."""
        if self.landmarks is not None:
            return min(self.landmarks, materials)
        return materials if materials <= MOST_LAID_OUT else LANDMARKS


@dataclass(frozen=True)
class GplvmSettings(Settings):
    """The settings of a Gaussian-process latent variable model of whole materials (Hikichi & Iwasaki).

    It also has the attributes of `Settings`.

    Attributes:
        mapping: name of the mapping.
        optimizer: one of `registries.OPTIMIZERS`.
        mu: noise filter of the kernel.
        prior: weight of the Gaussian prior on the latents, per output.
        kernel: name of the kernel, see `kernel_named`.
        grid: name of the grid of direction pairs for the Gram matrix.
        as_published: use the method exactly as Hikichi & Iwasaki published it, see `published`.
    """

    mapping: str = DEFAULT_MAPPING
    optimizer: str = DEFAULT_OPTIMIZER
    mu: float = DEFAULT_MU
    prior: float = DEFAULT_PRIOR
    kernel: str = DEFAULT_KERNEL
    grid: str = DEFAULT_GRID
    as_published: bool = False
    kind: ClassVar[str] = "gplvm"

    @classmethod
    def published(cls) -> GplvmSettings:
        """Return the settings of the method exactly as published; docs/explanation/gplvm.md lists their effects.

        The method uses raw values without weights, in all bands and at all 90 x 90 x 180 direction pairs, with zeros
        in unmeasured cells; s^2 = 1, mu = 1e-4 and l = 1; and direct local search from the principal components, in
        the order of the materials.
        """
        return cls(
            mapping="identity",
            optimizer="dls",
            mu=1e-4,
            prior=0.0,
            kernel="se",
            grid="hikichi",
            as_published=True,
        )

    def __post_init__(self) -> None:
        if not isinstance(self.kernel, str):
            raise UsageError(
                f"kernel {self.kernel!r}, expected a kernel's name, because a model file cannot store a class"
            )
        super().__post_init__()
        MAPPINGS[self.mapping]  # checks it
        if self.optimizer not in OPTIMIZERS:
            raise UsageError(f"optimizer '{self.optimizer}', expected {OPTIMIZERS}")
        RusinkiewiczGrid.named(self.grid)  # checks it
        require_mu(self.mu)
        require_prior(self.prior)
        if self.as_published and (self.mapping, self.optimizer) != ("identity", "dls"):
            raise UsageError(
                f"as_published with mapping {self.mapping} and optimizer {self.optimizer}, expected "
                "GplvmSettings.published()"
            )

    def covariance(self) -> Kernel:
        """Return the kernel with its parameters."""
        return kernel_named(self.kernel, self.mu, self.length_scale)

    @property
    def fills_cells(self) -> bool:
        """Return whether unmeasured cells are filled; they are zeros in the published method."""
        return not self.as_published

    @property
    def output_variance(self) -> float | None:
        """Return the output variance s^2, in squared units of the outputs; None if it is fitted."""
        return 1.0 if self.as_published else None


KINDS: dict[str, type[BlendSettings] | type[GplvmSettings]] = {
    settings.kind: settings for settings in (BlendSettings, GplvmSettings)
}
"""Classes of settings, by the name of the kind of manifold."""


def _require_whole(name: str, value: object, least: int) -> None:
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise UsageError(f"{name} is {value!r}, expected a whole number of at least {least}")
