from . import directions, errors, mapping, metrics

__all__ = [
    "directions",
    "errors",
    "mapping",
    "metrics",
]
