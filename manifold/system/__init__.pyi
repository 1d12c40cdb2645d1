from . import atomic, caching, names, parallel, progress, reading

__all__ = ["atomic", "caching", "names", "parallel", "progress", "reading"]
