from .adam_and_swarm import AdamOptions, SwarmOptions
from .bsdf_parameters import BsdfFamily, FreeParameter
from .fit_samples import FitSamples
from .fitted_brdf import FittedBRDF
from .gauss_newton import GaussNewton
from .identifiability import ParameterIdentifiability
from .principled import FitResult, fit_bsdf

__all__ = [
    "AdamOptions",
    "BsdfFamily",
    "FitResult",
    "FitSamples",
    "FittedBRDF",
    "FreeParameter",
    "GaussNewton",
    "ParameterIdentifiability",
    "SwarmOptions",
    "fit_bsdf",
]
