"""
Predicted and measured
======================

Four materials are left out of a map, located on it from their own data, and predicted (top row). The bottom row shows
the measured files.
"""

import matplotlib.pyplot as plt

import manifold as mf

left_out = ["syn_metal_copper", "syn_gloss_green", "syn_paper_blue", "syn_satin_purple"]
names = [name for name in mf.Library("library.zarr").names if name not in left_out]
model = mf.Manifold.fit("library.zarr", names=set(names[::2]), calibrate=False)

_, axes = plt.subplots(2, 4, figsize=(9, 5), layout="constrained")
for name, (above, below) in zip(left_out, axes.T, strict=True):
    measured = mf.MeasuredBRDF(mf.read_bsdf(f"corpus/{name}_rgb.bsdf"))
    located = model.embed(measured)
    predicted = model.predict(located.latent, located.colours)
    for axis, material in ((above, predicted), (below, measured)):
        axis.imshow(mf.render_ball(material, size=192).clip(0, 1) ** (1 / 2.2))
        axis.axis("off")
    above.set(title=name.removeprefix("syn_"))
