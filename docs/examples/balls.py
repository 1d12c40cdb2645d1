"""Balls in a row, for the scripts of the gallery."""

import matplotlib.pyplot as plt

import manifold as mf


def show(materials):
    """Draw a ball of every material, {title: BRDF} or {title: (BRDF, illuminant)}, in one row."""
    _, axes = plt.subplots(1, len(materials), figsize=(2.2 * len(materials), 2.4), layout="constrained")
    for axis, (title, material) in zip(axes.flat, materials.items(), strict=True):
        brdf, illuminant = material if isinstance(material, tuple) else (material, "D65")
        picture = mf.render_ball(brdf, size=160, illuminant=illuminant)
        axis.imshow(picture.clip(0, 1) ** (1 / 2.2))
        axis.set_title(title, fontsize=9)
        axis.axis("off")
