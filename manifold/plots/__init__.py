"""Figures of maps, balls and slices, drawn to files without a window."""
