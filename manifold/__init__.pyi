from . import colour, directions, errors, latent, mapping, metrics
from .brdf import analytic
from .brdf.measured import MeasuredBRDF
from .fitting.principled import fit_bsdf
from .io_rgl import read_bsdf, write_bsdf
from .library.importing import import_files
from .library.store import Library
from .model.manifold import Manifold
from .model.settings import Settings
from .records import Bands
from .rendering.ball import render_ball

__version__: str

__all__ = [
    "Bands",
    "Library",
    "Manifold",
    "MeasuredBRDF",
    "Settings",
    "analytic",
    "colour",
    "directions",
    "errors",
    "fit_bsdf",
    "import_files",
    "latent",
    "mapping",
    "metrics",
    "read_bsdf",
    "render_ball",
    "write_bsdf",
]
