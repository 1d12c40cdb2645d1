"""
A texture of latents
====================

One BSDF, a field of materials: the latent wanders from copper to a green leaf and back over the sphere. Rendered by the
plugin, which evaluates the measured materials themselves.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import manifold as mf
from manifold.render import backend, scenes
from manifold.render.render import rgb_film

path = Path(os.environ["MANIFOLD_DOCS_WORK"]) / "model.h5"
model = mf.Manifold.load(path)
mi = backend.mitsuba("rgb")
steps = np.linspace(0.0, 1.0, 65)
latents = np.array([model.between("syn_metal_copper", "syn_leaf_grass", t) for t in steps])

u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 256), np.linspace(0.0, np.pi, 128))
share = 0.5 + 0.5 * np.sin(3.0 * u + 4.0 * np.cos(3.0 * v)) * np.sin(v)
textures = {
    f"latent_{k}": {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.interp(share, steps, latents[:, k]).astype(np.float32)[:, :, None]),
        "raw": True,  # numbers, not colours
    }
    for k in range(2)
}
bsdf = {"type": "manifold", "model": str(path), **textures}
picture = np.array(mi.render(mi.load_dict(scenes.material_ball(mi, bsdf, rgb_film(240))), spp=32))
plt.figure(figsize=(4, 4), layout="constrained")
plt.imshow(picture.clip(0, 1) ** (1 / 2.2))
plt.axis("off")
