"""The Mitsuba BSDF `manifold`: predictions on Dr.Jit arrays, straight from the measured files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
