from .atoms import LibraryAtoms
from .completion import Completion
from .completions import complete
from .expected import calibrate
from .predictions import locate, predict, reconstruct
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
