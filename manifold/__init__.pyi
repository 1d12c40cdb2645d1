from . import analytic, colour, dls, gplvm, gpr
from .brdf.measured import MeasuredBRDF
from .core import directions, errors, mapping, metrics
from .core.records import Bands
from .fit.principled import fit_bsdf
from .io_rgl import read_bsdf, write_bsdf
from .library.importing import import_files
from .library.store import Library
from .model.manifold import Manifold
from .model.settings import Settings
from .render.ball import render_ball

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
    "dls",
    "errors",
    "fit_bsdf",
    "gplvm",
    "gpr",
    "import_files",
    "mapping",
    "metrics",
    "read_bsdf",
    "render_ball",
    "write_bsdf",
]
