from .conversion import convert

__all__ = [
    "convert",
]
