from . import goniometer
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
    "goniometer",
    "physical_file",
    "unmeasured_cells",
    "unmeasured_share",
]
