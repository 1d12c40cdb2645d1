from . import goniometer
from .measured import BRDF

__all__ = [
    "BRDF",
    "goniometer",
]
