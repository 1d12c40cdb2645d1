from .tensor_file import read_tensors, write_tensors

__all__ = [
    "read_tensors",
    "write_tensors",
]
