from .files import make_surface

__all__ = [
    "make_surface",
]
