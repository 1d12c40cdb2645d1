"""The interactive map: tables of a model, and the web page that predicts from them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
