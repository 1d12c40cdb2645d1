from .conversion import to_srgb
from .difference import delta_e_2000
from .illuminants import illuminant_names
from .reflectances import metal_ior, read_reflectance, srgb_reflectance

__all__ = [
    "delta_e_2000",
    "illuminant_names",
    "metal_ior",
    "read_reflectance",
    "srgb_reflectance",
    "to_srgb",
]
