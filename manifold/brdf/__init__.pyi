from . import goniometer
from .arrays import to_xarray
from .interface import BRDF

__all__ = [
    "BRDF",
    "goniometer",
    "to_xarray",
]
