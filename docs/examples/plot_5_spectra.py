"""
Spectra under a fluorescent lamp
================================

A file in RGB describes a material under one illuminant. Under the lamp F11, whose light is in a few lines, its 195
bands give another colour than three channels do, also after the eye has adapted to the lamp.
"""

import os
from pathlib import Path

from balls import show

import manifold as mf
from manifold.analytic import corpus

rgb = mf.MeasuredBRDF(mf.read_bsdf(Path(os.environ["MANIFOLD_DOCS_WORK"]) / "corpus/syn_satin_gold_rgb.bsdf"))
recipes = {material.name: material for material in corpus.isotropic_materials()}
spectral = mf.MeasuredBRDF(corpus.measure(recipes["syn_satin_gold"]))
show({"RGB, any light": rgb, "195 bands, D65": spectral, "195 bands, F11": (spectral, "F11")})
