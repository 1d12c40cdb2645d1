from .adam_and_swarm import AdamOptions, SwarmOptions
from .fit_samples import FitSamples
from .gauss_newton import GaussNewton
from .identifiability import ParameterIdentifiability
from .principled import FitResult, fit_bsdf

__all__ = [
    "AdamOptions",
    "FitResult",
    "FitSamples",
    "GaussNewton",
    "ParameterIdentifiability",
    "SwarmOptions",
    "fit_bsdf",
]
