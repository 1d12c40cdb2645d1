from . import analytic, colour, dls, gplvm, gpr
from .brdf.measured import MeasuredBRDF
from .core import directions, errors, mapping, metrics
from .core.records import Bands
from .estimate.reading_completion import complete_readings
from .fit.principled import fit_bsdf
from .formats.registry import read_readings
from .io_rgl import read_bsdf, write_bsdf
from .library.importing import import_files
from .library.store import Library
from .model.manifold import Manifold, built_in
from .model.settings import BlendSettings, GplvmSettings
from .render.ball import render_ball

__version__: str

__all__ = [
    "Bands",
    "BlendSettings",
    "GplvmSettings",
    "Library",
    "Manifold",
    "MeasuredBRDF",
    "analytic",
    "built_in",
    "colour",
    "complete_readings",
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
    "read_readings",
    "render_ball",
    "write_bsdf",
]
