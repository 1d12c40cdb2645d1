from . import corpus
from .base import Lambert, Sheen
from .diffuse import RoughDiffuse
from .ggx import GGX
from .ggx_mixture import GGXMixture
from .layers import Immersed, Layered, MixedBRDF, Retroreflection
from .microfacet import Plastic, RoughConductor, RoughDielectric, ThinFilm

__all__ = [
    "GGX",
    "GGXMixture",
    "Immersed",
    "Lambert",
    "Layered",
    "MixedBRDF",
    "Plastic",
    "Retroreflection",
    "RoughConductor",
    "RoughDielectric",
    "RoughDiffuse",
    "Sheen",
    "ThinFilm",
    "corpus",
]
