from .estimate import estimate_surface
from .files import make_surface
from .lamp_pictures import read_workbook
from .tiling import tile

__all__ = [
    "estimate_surface",
    "make_surface",
    "read_workbook",
    "tile",
]
