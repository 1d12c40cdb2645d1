"""Estimates surfaces from pictures: colour, slope and sparkle per pixel, in addition to a completed BRDF."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
