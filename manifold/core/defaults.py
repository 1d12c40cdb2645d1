"""Default numbers that several modules share."""

DEFAULT_MU = 1e-4
"""The noise filter of Hikichi & Iwasaki (section 3.3)."""
FINE_INCIDENCES = 24
"""Number of incidences in files of completions; with eight, colours at the readings change by up to 2.3 CIEDE2000, with
24 by 0.3."""
TINY = 1e-9
"""Smallest divisor, and largest share that is treated as 0; far below any visible or measurable value."""
