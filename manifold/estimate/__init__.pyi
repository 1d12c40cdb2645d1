from .atoms import LibraryAtoms
from .completion import Completion
from .completions import complete
from .descriptions import locate, reconstruct
from .expected import calibrate
from .predictions import predict
from .suggestions import suggest

__all__ = [
    "Completion",
    "LibraryAtoms",
    "calibrate",
    "complete",
    "locate",
    "predict",
    "reconstruct",
    "suggest",
]
