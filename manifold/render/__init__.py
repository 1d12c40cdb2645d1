"""Rendering with Mitsuba: backend, scenes, renderings, images and their differences.

Only `backend` imports mitsuba and drjit.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
