from .colours import ColourChoice
from .comparison import brdf_errors, rmse22
from .output_file import OutputOptions

__all__ = [
    "ColourChoice",
    "OutputOptions",
    "brdf_errors",
    "rmse22",
]
