"""A low-dimensional manifold of measured spectral BRDFs."""

__version__ = "0.1.0"
