"""
Between two materials
=====================

A walk from a matt to a glossy material, in steps that look equally large.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt

import manifold as mf

model = mf.Manifold.load(Path(os.environ["MANIFOLD_DOCS_WORK"]) / "model.h5")
figure, axes = plt.subplots(1, 5, figsize=(10, 2))
for k, axis in enumerate(axes):
    picture = mf.render_ball(model.interpolate(model.names[0], model.names[-1], k / 4), size=128)
    axis.imshow(picture.clip(0, 1) ** (1 / 2.2))
    axis.axis("off")
