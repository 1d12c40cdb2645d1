from .dense import DenseTable
from .readings import Readings, geometry_ma_t12
from .registry import read_all, read_readings
from .tensor_file import read_tensors, write_tensors

__all__ = [
    "DenseTable",
    "Readings",
    "geometry_ma_t12",
    "read_all",
    "read_readings",
    "read_tensors",
    "write_tensors",
]
