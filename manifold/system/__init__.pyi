from . import atomic, parallel, small_files, temporary

__all__ = ["atomic", "parallel", "small_files", "temporary"]
