from . import corpus
from .analytic import Lambert, Sheen
from .ggx import GGX
from .layers import Layered, MixedBRDF
from .microfacet import Plastic, RoughConductor, RoughDielectric, ThinFilm

__all__ = [
    "GGX",
    "Lambert",
    "Layered",
    "MixedBRDF",
    "Plastic",
    "RoughConductor",
    "RoughDielectric",
    "Sheen",
    "ThinFilm",
    "corpus",
]
