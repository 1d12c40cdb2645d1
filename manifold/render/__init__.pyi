from .backend import Backend, RendererWarning
from .ball import render_ball, render_material
from .bsdf_parameters import BsdfFamily, FreeParameter
from .fitted_brdf import FittedBRDF
from .image_metrics import ciede2000_map, flip_map
from .images import read_image, tone_map, write_image
from .render import RenderSettings, render_bsdf

__all__ = [
    "Backend",
    "BsdfFamily",
    "FittedBRDF",
    "FreeParameter",
    "RenderSettings",
    "RendererWarning",
    "ciede2000_map",
    "flip_map",
    "read_image",
    "render_ball",
    "render_bsdf",
    "render_material",
    "tone_map",
    "write_image",
]
