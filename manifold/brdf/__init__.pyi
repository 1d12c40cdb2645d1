from .measured import BRDF, MeasuredBRDF
from .pairs import DirectionPairs
from .physical import PhysicalBRDF
from .unmeasured import fill_unmeasured, unmeasured_cells, unmeasured_share

__all__ = [
    "BRDF",
    "DirectionPairs",
    "MeasuredBRDF",
    "PhysicalBRDF",
    "fill_unmeasured",
    "unmeasured_cells",
    "unmeasured_share",
]
