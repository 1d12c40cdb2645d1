"""The interactive map: a web page with the tables from which it predicts, and its server."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
