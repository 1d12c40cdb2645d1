"""
From twelve readings
====================

The twelve geometries of a multi-angle spectrophotometer hardly determine the highlight. Two more readings in mirror
directions determine it. The material itself is left out of the library.
"""

import matplotlib.pyplot as plt
import numpy as np

import manifold as mf
from manifold.estimate import Completion, LibraryAtoms
from manifold.formats import Readings, geometry_ma_t12

sample = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_gloss_red_rgb.bsdf"))
atoms = LibraryAtoms.of_library(mf.Library("library.zarr"))
atoms = atoms.without("syn_gloss_red")


def complete(wi, wo):
    """Return the BRDF that is estimated from the sample's values at pairs of directions."""
    return Completion.of(atoms, Readings("sample", "instrument", wi, wo, None, sample.eval(wi, wo))).brdf


wi, wo = geometry_ma_t12()
incidences = np.deg2rad([20.0, 60.0])
mirror_wi = mf.directions.from_spherical(incidences, np.pi)
mirror_wo = mf.directions.from_spherical(incidences, 0.0)
materials = {
    "12 readings": complete(wi, wo),
    "and 2 mirror readings": complete(np.vstack([wi, mirror_wi]), np.vstack([wo, mirror_wo])),
    "measured": sample,
}

_, axes = plt.subplots(1, 3, figsize=(7, 2.6), layout="constrained")
for (title, material), axis in zip(materials.items(), axes, strict=True):
    axis.imshow(mf.render_ball(material, size=192).clip(0, 1) ** (1 / 2.2))
    axis.set(title=title)
    axis.axis("off")
