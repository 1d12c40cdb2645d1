"""Fits of a BSDF that Mitsuba renders: samples, parameters, optimisers, identifiability, and fits as JSON."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
