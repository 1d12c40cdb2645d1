"""The exceptions of the package: one base class, messages of one line.

A message says where, what was found, what was expected, and what to do.
"""


class ManifoldError(Exception):
    """Base of all errors of this package."""


class FileFormatError(ManifoldError):
    """A file is not what its name or its neighbours promise."""


class ShapeError(ManifoldError, ValueError):
    """An array has the wrong shape, dtype, or non-finite values."""


class BandMismatchError(ManifoldError):
    """Two things with different bands were to be used together."""


class LibraryError(ManifoldError):
    """A library is missing, of another version, or damaged."""


class ModelError(ManifoldError):
    """A model file is missing, of another version, or does not fit its library."""


class FetchError(ManifoldError):
    """A download failed, or what arrived is not what was announced."""


class NumericalError(ManifoldError):
    """A factorisation or an iteration failed."""


class RendererError(ManifoldError):
    """Mitsuba, which rendering and fitting need, is missing, or lacks the backend that a method needs."""


class UsageError(ManifoldError):
    """A value given by the user cannot be used."""


class LatentError(UsageError, ShapeError):
    """A latent coordinate has the wrong number of values, or values that are no numbers."""
