from .widget import MapWidget

__all__ = [
    "MapWidget",
]
