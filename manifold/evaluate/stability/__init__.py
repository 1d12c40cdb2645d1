"""`manifold stability`: a catalogue of failure modes, and whether they are detected."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
