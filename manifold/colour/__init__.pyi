from .conversion import decode_srgb, encode_srgb, luminance, srgb_to_xyz, to_srgb, to_xyz, xyz_to_srgb
from .difference import VISIBLE, colour_differences, delta_e_2000, to_lab
from .illuminants import Illuminant, illuminant_names
from .metals import metal_ior, metal_names
from .reflectances import (
    ReflectanceSpectrum,
    diffuse_reflectance,
    diffuse_reflectance_names,
    read_reflectance,
    srgb_reflectance,
)

__all__ = [
    "VISIBLE",
    "Illuminant",
    "ReflectanceSpectrum",
    "colour_differences",
    "decode_srgb",
    "delta_e_2000",
    "diffuse_reflectance",
    "diffuse_reflectance_names",
    "encode_srgb",
    "illuminant_names",
    "luminance",
    "metal_ior",
    "metal_names",
    "read_reflectance",
    "srgb_reflectance",
    "srgb_to_xyz",
    "to_lab",
    "to_srgb",
    "to_xyz",
    "xyz_to_srgb",
]
