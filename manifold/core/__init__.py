"""Basics of every subject: errors, records, names, files on disk, work shared among processes, directions, mappings."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
