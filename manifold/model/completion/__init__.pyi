from .complete import Completion, complete
from .expected import Calibration, calibrate
from .samples import LibrarySamples
from .suggest import suggest

__all__ = [
    "Calibration",
    "Completion",
    "LibrarySamples",
    "calibrate",
    "complete",
    "suggest",
]
