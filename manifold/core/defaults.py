"""Numbers that several modules share, in a module that imports nothing."""

DEFAULT_MU = 1e-4
"""The noise filter of Hikichi & Iwasaki (section 3.3)."""
FINE_INCIDENCES = 24
"""Incidences of completions: eight change colours at the readings by up to 2.3 CIEDE2000, 24 by 0.3."""
TINY = 1e-9
"""Smallest divisor, and largest share that counts as none: far below any value that can be seen or measured."""
