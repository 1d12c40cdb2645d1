from .estimate import estimate_surface
from .files import make_surface
from .lamp_pictures import read_workbook
from .tiling import tile
from .written import read_surface

__all__ = [
    "estimate_surface",
    "make_surface",
    "read_surface",
    "read_workbook",
    "tile",
]
