"""Figures. These modules alone import matplotlib; none opens a window."""
