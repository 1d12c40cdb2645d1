"""Commands for many materials, or at many places: what each does with one, as tasks of a batch."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
