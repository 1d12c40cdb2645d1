from .catalogue import MODES
from .trials import Stability, run_modes

__all__ = [
    "MODES",
    "Stability",
    "run_modes",
]
