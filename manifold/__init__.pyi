from . import colour, directions, errors, mapping, metrics, models
from .brdf import synthetic
from .brdf.measured import MeasuredBRDF
from .fitting.principled import fit_bsdf
from .io_rgl import read_bsdf, write_bsdf
from .library.importing import import_files
from .library.store import Library
from .model.manifold import Manifold, Settings
from .records import Bands
from .workflows.renders import render_ball

__version__: str

__all__ = [
    "Bands",
    "Library",
    "Manifold",
    "MeasuredBRDF",
    "Settings",
    "colour",
    "directions",
    "errors",
    "fit_bsdf",
    "import_files",
    "mapping",
    "metrics",
    "models",
    "read_bsdf",
    "render_ball",
    "synthetic",
    "write_bsdf",
]
