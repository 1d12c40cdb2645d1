"""Exports materials as shaders: a table of half floats, and code that evaluates and samples it in real time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
