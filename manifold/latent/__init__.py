"""Gaussian-process models behind the manifold, arrays in and arrays out: kernels, latent variables, encoders.

Names are imported when they are first used.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "Decoder": "manifold.latent.decoder",
    "direct_local_search": "manifold.dls",
    "Encoder": "manifold.latent.encoder",
    "GPLVM": "manifold.gplvm",
    "GPRegressor": "manifold.estimators",
    "GaussianProcess": "manifold.gpr",
    "hooke_jeeves": "manifold.dls",
    "Kernel": "manifold.latent.kernels",
    "kernel_named": "manifold.latent.kernels",
    "Lobes": "manifold.latent.lobes",
    "nonnegative_weights": "manifold.latent.nonnegative",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
