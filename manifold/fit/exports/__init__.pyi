from .document import Export
from .principled_values import Principled
from .targets import TARGETS, Target, target_of

__all__ = [
    "TARGETS",
    "Export",
    "Principled",
    "Target",
    "target_of",
]
