from .atoms import LibraryAtoms
from .completion import Completion
from .completions import complete
from .expected import Calibration, calibrate
from .photo_material import PhotoMaterial, find_material
from .photograph import Circle, Photograph, find_outlines, read_photograph
from .pixels import Camera, Environment
from .predictions import locate, predict, reconstruct
from .sightings import Sighting
from .suggestions import suggest

__all__ = [
    "Calibration",
    "Camera",
    "Circle",
    "Completion",
    "Environment",
    "LibraryAtoms",
    "PhotoMaterial",
    "Photograph",
    "Sighting",
    "calibrate",
    "complete",
    "find_material",
    "find_outlines",
    "locate",
    "predict",
    "read_photograph",
    "reconstruct",
    "suggest",
]
