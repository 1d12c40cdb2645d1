"""Figures, and the interactive map. These modules alone import matplotlib; none shows a window."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
