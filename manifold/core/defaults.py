"""Defaults that helps print, and numbers that several modules share, in a module that imports nothing."""

# A fit; the noise filter and the length scale are those of Hikichi & Iwasaki (section 3.3).
DEFAULT_MU, DEFAULT_LENGTH_SCALE, DEFAULT_PRIOR = 1e-4, 1.0, 0.0
DEFAULT_KERNEL, DEFAULT_OPTIMIZER, DEFAULT_MAPPING, DEFAULT_GRID = "se", "dls", "cube-root", "default"
MOST_LAID_OUT = 300
"""Number of materials up to which a map of blends lays out all of them; the GPLVM takes no more."""
LANDMARKS = 150
"""Number of materials of a larger library that a map of blends lays out."""

# Readings
ILLUMINANT, OBSERVER_DEG = "D65", 2
REPEATABILITY = 0.0025
"""Repeatability of a spectrophotometer, relative: 0.05 CIEDE2000."""
GONIOMETER = 0.03
"""Repeatability of a goniometer."""
MINI_DIFF_SEES_DEG = 75.0
"""Largest outgoing angle of a Mini-Diff's sensor; beyond it, its files ramp to zero."""

# Written files
SURFACE_TARGETS = ("gltf", "openpbr", "usd", "blender")
"""Targets of exports that a textured material is written for."""
FINE_INCIDENCES = 24
"""Number of incidences in files of completions; with eight, colours at the readings change by up to 2.3 CIEDE2000, with
24 by 0.3."""
CONVERTED_RESOLUTION = 64
"""Nodes per axis of the outgoing grid of a converted file."""
COMPACT_TOLERANCE, SHADER_TOLERANCE = 0.2, 0.3
"""Mean CIEDE2000 of the ball that a compact material, or a shader's table, may differ by."""

DARKEST = 1e-3
"""Smallest reflectance, or share of a largest value, in logarithms and quotients: darker ones look black."""
RIDGE = 1e-6
"""Share of noise that is added to covariances, so that they can be solved even if samples coincide."""
TINY = 1e-9
"""Smallest divisor, far below any visible or measurable value."""
ROUNDING = 1e-9
"""Largest relative difference that counts as rounding, and largest share, gain or gradient that counts as none."""
