"""Export targets: glTF, MaterialX, USD, Blender, Unreal and Unity, with their parameters, shading models and files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
