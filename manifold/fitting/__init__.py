"""Materials as parameters: fits of a BSDF that Mitsuba renders, their JSON, and exports for engines."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
