"""`manifold budget`: the cheapest representation of each material that preserves a scene's image."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
