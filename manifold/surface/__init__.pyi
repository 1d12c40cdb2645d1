from .estimate import Surface, estimate_surface
from .files import SurfaceFiles, make_surface
from .lamp_pictures import SurfacePictures, read_folder, read_workbook
from .sparkle import Sparkle, sparkle_of
from .tiling import Textures, tile

__all__ = [
    "Sparkle",
    "Surface",
    "SurfaceFiles",
    "SurfacePictures",
    "Textures",
    "estimate_surface",
    "make_surface",
    "read_folder",
    "read_workbook",
    "sparkle_of",
    "tile",
]
