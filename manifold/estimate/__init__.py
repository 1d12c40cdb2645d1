"""Estimates materials from readings, gloss, photographs, files or attributes, and suggests what to measure next."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
