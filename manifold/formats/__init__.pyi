from .readings import Readings, geometry_ma_t12
from .registry import read_all, read_readings

__all__ = [
    "Readings",
    "geometry_ma_t12",
    "read_all",
    "read_readings",
]
