"""Figures of maps, balls and slices; those of other subjects lie in their folders. None shows a window."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
