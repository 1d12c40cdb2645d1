"""Basics for all other folders: errors, records, names, files, parallel work, directions and mappings."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__, submodules=["directions", "errors", "mapping", "metrics"]
)
