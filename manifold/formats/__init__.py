"""Readers and writers of the files of instruments and other programs, one module per format."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
