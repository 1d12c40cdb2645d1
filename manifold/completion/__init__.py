"""Completion of a BRDF from few readings, with a library of measured materials as prior."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
