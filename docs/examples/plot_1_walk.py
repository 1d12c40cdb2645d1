"""
Between two materials
=====================

A walk interpolates from a matt felt to a satin metal, in steps that look equally large. Properties that the two
materials share do not change, and gloss and hue never go back and forth.
"""

import matplotlib.pyplot as plt

import manifold as mf

model = mf.Manifold.load("model.h5")

_, axes = plt.subplots(1, 5, figsize=(11, 2.5), layout="constrained")
for k, axis in enumerate(axes):
    material = model.interpolate("syn_felt_purple", "syn_satin_gold", k / 4)
    axis.imshow(mf.render_ball(material, size=192).clip(0, 1) ** (1 / 2.2))
    axis.set(title=f"{k / 4:.2f}")
    axis.axis("off")
