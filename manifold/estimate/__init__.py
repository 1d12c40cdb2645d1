"""A material from observations: readings, gloss, photographs, whole files, attributes; and what to measure next."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
