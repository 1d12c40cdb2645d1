from .targets import TARGETS

__all__ = [
    "TARGETS",
]
