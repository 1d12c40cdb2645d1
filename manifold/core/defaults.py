"""Defaults that helps of commands state; they stand here once, in a module that imports nothing."""

DEFAULT_MU = 1e-4
"""The noise filter of kernels, of Hikichi & Iwasaki."""
FINE_INCIDENCES = 24
"""Angles of incidence of completed materials."""
