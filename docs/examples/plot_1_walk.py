"""
Between two materials
=====================

A walk from a matt felt to a satin metal, in steps that look equally large. It changes what differs between its ends and
nothing else: gloss and hue never go back and forth.
"""

import os
from pathlib import Path

from balls import show

import manifold as mf

model = mf.Manifold.load(Path(os.environ["MANIFOLD_DOCS_WORK"]) / "model.h5")
show({f"{k / 4:.2f}": model.interpolate("syn_felt_purple", "syn_satin_gold", k / 4) for k in range(5)})
