from . import goniometer, synthetic
from .gloss import gloss_units
from .measured import BRDF, MeasuredBRDF
from .pairs import DirectionPairs
from .physical import ReciprocalBRDF, physical_file
from .unmeasured import fill_unmeasured, unmeasured_cells, unmeasured_share

__all__ = [
    "BRDF",
    "DirectionPairs",
    "MeasuredBRDF",
    "ReciprocalBRDF",
    "fill_unmeasured",
    "gloss_units",
    "goniometer",
    "physical_file",
    "synthetic",
    "unmeasured_cells",
    "unmeasured_share",
]
