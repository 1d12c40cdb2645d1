"""The settings of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import Any, cast

from manifold.core.errors import UsageError
from manifold.core.pairs import RusinkiewiczGrid
from manifold.gp.kernels import Kernel, kernel_named, require_mu
from manifold.registries import MAPPINGS, OPTIMIZERS

_KIND_DEFAULTS: dict[str, dict[str, Any]] = {
    "blend": {"optimizer": "l-bfgs", "mu": 1e-4, "prior": 0.0},
    "gplvm": {"optimizer": "dls", "mu": 1e-4, "prior": 0.0},
}
_OLD_KINDS = {"material": "gplvm"}  # names of earlier versions

KINDS = tuple(_KIND_DEFAULTS)

MOST_LAID_OUT = 300
"""Number of materials up to which a map of blends lays out all of them; other kinds take no more."""
_LANDMARKS = 150


@dataclass(frozen=True)
class Settings:
    """The settings with which a manifold was fitted.

    Attributes:
        kind: `blend`, every point a non-negative combination of materials; or `gplvm`, the method of Hikichi & Iwasaki,
            which was called `material`.
        latent_dim: Q.
        mapping: name of the mapping.
        optimizer: one of `registries.OPTIMIZERS`; None is the kind's own. Blends have `l-bfgs` only.
        mu: noise filter of the kernel; None is the kind's own.
        prior: weight of the Gaussian prior on the latents; None is the kind's own.
        length_scale: l, in units of the latents.
        kernel: name of the kernel, see `kernel_named`.
        grid: name of the grid of direction pairs behind the Gram matrix.
        sample_bands: bands per material of which colours of blends are made, at most.
        landmarks: number of materials of a map of blends that are laid out, the others being located among them; None
            is all of at most 300 materials, and 150 of more.
        as_published: follow Hikichi & Iwasaki to the letter, see `published`.
    """

    kind: str = "blend"
    latent_dim: int = 2
    mapping: str = "cube-root"
    optimizer: str = cast(str, None)
    mu: float = cast(float, None)
    prior: float = cast(float, None)
    length_scale: float = 1.0
    kernel: str = "se"
    grid: str = "default"
    sample_bands: int = 5
    landmarks: int | None = None
    as_published: bool = False

    @classmethod
    def published(cls) -> Settings:
        """Return the settings of Hikichi & Iwasaki to the letter; docs/explanation/gplvm.md lists their effects.

        Raw values without weights, in all bands and at all 90 x 90 x 180 direction pairs; unmeasured cells are zeros;
        s^2 = 1; direct local search from the principal components in the order of the materials; mu = 1e-4, l = 1.
        """
        return cls("gplvm", 2, "identity", grid="hikichi", as_published=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", _OLD_KINDS.get(self.kind, self.kind))
        if self.kind not in KINDS:
            raise UsageError(f"kind '{self.kind}', expected {' or '.join(KINDS)}")
        for name, value in _KIND_DEFAULTS[self.kind].items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        MAPPINGS[self.mapping]  # checks it
        optimizers = ("l-bfgs",) if self.kind == "blend" else tuple(OPTIMIZERS)
        if self.optimizer not in optimizers:
            raise UsageError(
                f"optimizer '{self.optimizer}' for kind {self.kind}, expected {' or '.join(optimizers)}"
            )
        if self.kind == "blend" and self.mapping != "cube-root":
            raise UsageError(f"mapping '{self.mapping}' for kind blend, expected cube-root")
        for name, least in (("latent_dim", 1), ("sample_bands", 2)):
            value = getattr(self, name)
            if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
                raise UsageError(f"{name} is {value!r}, expected a whole number from {least}")
        if self.landmarks is not None and (self.kind != "blend" or self.landmarks <= self.latent_dim + 1):
            raise UsageError(
                f"landmarks = {self.landmarks} for kind {self.kind} in {self.latent_dim} dimensions, expected kind "
                f"blend, and at least {self.latent_dim + 2}"
            )
        if self.as_published and (
            self.kind == "blend" or (self.mapping, self.optimizer) != ("identity", "dls")
        ):
            raise UsageError(
                f"as_published with kind {self.kind}, mapping {self.mapping} and optimizer {self.optimizer}, expected "
                "Settings.published()"
            )
        RusinkiewiczGrid.named(self.grid)  # checks it
        if not isinstance(self.kernel, str):
            raise UsageError(f"kernel {self.kernel!r}, expected a name, which a model's file can hold")
        require_mu(self.mu)
        covariance = self.covariance()  # checks it
        if self.optimizer == "dls":
            _ = covariance.numbers  # checks it

    def landmarks_of(self, materials: int) -> int:
        """Return how many of `materials` materials are laid out as landmarks."""
        if self.landmarks is not None:
            return min(self.landmarks, materials)
        return materials if materials <= MOST_LAID_OUT else _LANDMARKS

    def covariance(self) -> Kernel:
        """Return the kernel with its parameters."""
        return kernel_named(self.kernel, self.mu, self.length_scale)
