"""
Predicted and measured
======================

Materials that a map never saw, found on it from their own data: above as predicted, below as measured.
"""

import os
from pathlib import Path

from balls import show

import manifold as mf

work = Path(os.environ["MANIFOLD_DOCS_WORK"])
unseen = ["syn_metal_copper", "syn_gloss_green", "syn_paper_blue", "syn_satin_purple"]
names = [name for name in mf.Library.open(work / "library.zarr").names if name not in unseen]
model = mf.Manifold.fit(work / "library.zarr", names=set(names[::2]), calibrate=False)

measured = {name[4:]: mf.MeasuredBRDF(mf.read_bsdf(work / "corpus" / f"{name}_rgb.bsdf")) for name in unseen}
found = {name: model.embed(brdf) for name, brdf in measured.items()}
show({name: model.predict(place.latent, place.colours) for name, place in found.items()})

# %%
# Measured:
show(measured)
