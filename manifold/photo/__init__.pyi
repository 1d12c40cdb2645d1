from .circle import Circle, find_circle
from .light import Environment
from .material import PhotoMaterial, Sighting, find_material
from .pictures import Photograph, read_photograph
from .pixels import Camera

__all__ = [
    "Camera",
    "Circle",
    "Environment",
    "PhotoMaterial",
    "Photograph",
    "Sighting",
    "find_circle",
    "find_material",
    "read_photograph",
]
