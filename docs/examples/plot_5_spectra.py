"""
Spectra under a fluorescent lamp
================================

An RGB file describes a material under one illuminant. The fluorescent lamp F11 emits most of its light in a few narrow
lines. Under it, 195 bands give another colour than three channels do, even after chromatic adaptation.
"""

import matplotlib.pyplot as plt

import manifold as mf
from manifold.analytic import corpus

rgb = mf.MeasuredBRDF(mf.read_bsdf("corpus/syn_satin_gold_rgb.bsdf"))
gold = next(material for material in corpus.isotropic_materials() if material.name == "syn_satin_gold")
spectral = mf.MeasuredBRDF(corpus.measure(gold))

_, axes = plt.subplots(1, 3, figsize=(7, 2.6), layout="constrained")
balls = {
    "RGB, any light": (rgb, "D65"),
    "195 bands, D65": (spectral, "D65"),
    "195 bands, F11": (spectral, "F11"),
}
for (title, (material, illuminant)), axis in zip(balls.items(), axes, strict=True):
    picture = mf.render_ball(material, size=192, illuminant=illuminant)
    axis.imshow(picture.clip(0, 1) ** (1 / 2.2))
    axis.set(title=title)
    axis.axis("off")
