from .principled import FitResult

__all__ = [
    "FitResult",
]
