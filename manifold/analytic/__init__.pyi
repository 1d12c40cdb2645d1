from . import corpus
from .base import Lambert
from .ggx import GGX
from .microfacet import Plastic, RoughConductor

__all__ = [
    "GGX",
    "Lambert",
    "Plastic",
    "RoughConductor",
    "corpus",
]
