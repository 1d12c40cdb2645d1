from . import goniometer
from .interface import BRDF

__all__ = [
    "BRDF",
    "goniometer",
]
