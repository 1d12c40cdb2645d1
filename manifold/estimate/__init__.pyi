from .atoms import LibraryAtoms
from .circle import Circle, find_outlines
from .complete import Completion, complete
from .expected import Calibration, calibrate
from .light import Environment
from .photo_files import Photograph, read_photograph
from .photo_material import PhotoMaterial, Sighting, find_material
from .pixels import Camera
from .predictions import predict
from .reconstructions import locate, reconstruct
from .suggest import suggest

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
