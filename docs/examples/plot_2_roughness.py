"""
Roughness
=========

A dielectric over a coloured base, from polished to matt. Any BRDF with ``eval`` can be rendered,
fitted, or written as a file.
"""

import numpy as np
from balls import show

import manifold as mf
from manifold.analytic import GGX, Plastic

base, index = np.array([0.5, 0.05, 0.1]), np.full(3, 1.5)
show(
    {
        f"alpha {alpha}": Plastic(GGX.isotropic(alpha), index, base, mf.Bands(None))
        for alpha in (0.02, 0.08, 0.2, 0.4, 0.8)
    }
)
