"""Defaults that helps of commands state; they stand here once, in a module that imports nothing."""

DEFAULT_MU = 1e-4
"""The noise filter of Hikichi & Iwasaki (section 3.3)."""
FINE_INCIDENCES = 24
"""Incidences of completions: eight change colours at the readings by up to 2.3 CIEDE2000, 24 by 0.3."""
