from .catalogue import MODES
from .trials import Stability, try_modes

__all__ = ["MODES", "Stability", "try_modes"]
