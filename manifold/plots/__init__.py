"""Figures of maps, balls and slices; those of other subjects lie in their folders. None shows a window."""
