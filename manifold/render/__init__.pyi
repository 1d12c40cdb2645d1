from .ball import render_material
from .bsdf_parameters import BsdfFamily, FreeParameter
from .images import write_image

__all__ = [
    "BsdfFamily",
    "FreeParameter",
    "render_material",
    "write_image",
]
