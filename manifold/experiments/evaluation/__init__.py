"""Held-out evaluation: methods compared on materials that they were not fitted to."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
