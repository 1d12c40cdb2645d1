"""A full BRDF from a few readings of a material, by what a library of measured materials is like."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
