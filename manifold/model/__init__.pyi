from .colours import ColourChoice
from .comparison import brdf_errors, rmse22
from .embedding import embed
from .output_file import OutputOptions

__all__ = [
    "ColourChoice",
    "OutputOptions",
    "brdf_errors",
    "embed",
    "rmse22",
]
