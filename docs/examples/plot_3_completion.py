"""
From twelve readings
====================

The twelve geometries of a multi-angle spectrophotometer say little about a highlight. Two readings more, in the mirror
direction, settle it.
"""

import os
from pathlib import Path

import numpy as np
from balls import show

import manifold as mf
from manifold.estimate import Completion, LibraryAtoms
from manifold.formats import Readings, geometry_ma_t12

work = Path(os.environ["MANIFOLD_DOCS_WORK"])
sample = mf.MeasuredBRDF(mf.read_bsdf(work / "corpus/syn_gloss_red_rgb.bsdf"))
atoms = LibraryAtoms.of_library(mf.Library.open(work / "library.zarr"))
atoms = atoms.without(atoms.names.index("syn_gloss_red"))

wi, wo = geometry_ma_t12()
mirror_i = mf.directions.from_spherical(np.deg2rad([20.0, 60.0]), np.pi)
mirror_o = mf.directions.from_spherical(np.deg2rad([20.0, 60.0]), 0.0)


def completed(wi, wo):
    """The sample's BRDF, from its values at some directions."""
    return Completion.of(atoms, Readings("sample", "instrument", wi, wo, None, sample.eval(wi, wo))).brdf


show(
    {
        "12 readings": completed(wi, wo),
        "and 2 mirror readings": completed(np.vstack([wi, mirror_i]), np.vstack([wo, mirror_o])),
        "measured": sample,
    }
)
