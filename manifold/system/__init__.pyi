from . import atomic, caching, names, parallel, reading, stages

__all__ = ["atomic", "caching", "names", "parallel", "reading", "stages"]
