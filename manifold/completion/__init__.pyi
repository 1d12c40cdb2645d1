from .atoms import LibraryAtoms
from .complete import Completion, complete
from .expected import Calibration, calibrate
from .suggest import suggest

__all__ = [
    "Calibration",
    "Completion",
    "LibraryAtoms",
    "calibrate",
    "complete",
    "suggest",
]
