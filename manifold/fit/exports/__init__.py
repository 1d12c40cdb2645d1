"""Materials for engines: parameters of glTF, MaterialX, USD, Blender, Unreal and Unity, their files and losses."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
