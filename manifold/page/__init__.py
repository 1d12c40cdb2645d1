"""The interactive map: a web page that holds the tables for its predictions, and the server of that page."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
