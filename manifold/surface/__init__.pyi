from .estimate import Surface, estimate_surface
from .pictures import SurfacePictures, read_folder, read_workbook
from .tiling import tile

__all__ = [
    "Surface",
    "SurfacePictures",
    "estimate_surface",
    "read_folder",
    "read_workbook",
    "tile",
]
