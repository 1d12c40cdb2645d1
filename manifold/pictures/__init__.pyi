from . import maps, slices
from .renders import compare, render

__all__ = [
    "compare",
    "maps",
    "render",
    "slices",
]
