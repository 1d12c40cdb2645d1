"""The interactive map: tables of a model, the page that predicts from them, and its server."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
