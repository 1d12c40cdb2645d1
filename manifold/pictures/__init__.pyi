from .renders import compare, render

__all__ = [
    "compare",
    "render",
]
