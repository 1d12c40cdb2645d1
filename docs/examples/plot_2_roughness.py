"""
Roughness
=========

A dielectric coat over a coloured base, from polished to matt. Every BRDF with ``eval`` can be rendered, fitted, or
written to a file.
"""

import matplotlib.pyplot as plt
import numpy as np

import manifold as mf
from manifold.analytic import GGX, Plastic

base, refractive_index = np.array([0.5, 0.05, 0.1]), np.full(3, 1.5)

_, axes = plt.subplots(1, 5, figsize=(11, 2.5), layout="constrained")
for alpha, axis in zip((0.02, 0.08, 0.2, 0.4, 0.8), axes, strict=True):
    material = Plastic(GGX.isotropic(alpha), refractive_index, base, mf.Bands(None))
    axis.imshow(mf.render_ball(material, size=192).clip(0, 1) ** (1 / 2.2))
    axis.set(title=f"alpha {alpha}")
    axis.axis("off")
