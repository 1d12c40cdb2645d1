"""The exceptions of the package, which share one base class.

A message is one line that says where the error occurred, what was found, what was expected, and what to do. Each class
also derives from the built-in exception that Python raises in such a case:

| class | also derives from | raised if |
|---|---|---|
| `FileFormatError` | `ValueError` | a file is not what its name promises |
| `ShapeError` | `ValueError` | an array has the wrong shape or dtype, or holds values that are not finite |
| `BandMismatchError` | `ValueError` | two objects that must have the same bands have different ones |
| `LibraryError` | `ValueError` | a library has an unsupported version, is damaged, or cannot be written |
| `MissingLibraryError` | `LibraryError`, `FileNotFoundError` | a library does not exist |
| `ModelError` | `ValueError` | a model has an unsupported version, is damaged, or does not fit its library |
| `MissingModelError` | `ModelError`, `FileNotFoundError` | a model does not exist |
| `FetchError` | `OSError` | a download failed |
| `NumericalError` | `ArithmeticError` | a factorisation or an iteration failed |
| `RendererError` | `RuntimeError` | Mitsuba is missing, or lacks the backend that an evaluation needs |
| `UsageError` | `ValueError` | a value given by the user cannot be used |
| `MissingFileError` | `UsageError`, `FileNotFoundError` | a file does not exist |
| `FileAccessError` | `UsageError`, `OSError` | a file cannot be read, or cannot be written |
| `UnknownNameError` | `UsageError`, `KeyError` | a name is unknown |
| `MissingPackageError` | `ImportError` | an optional package is not installed |
| `LatentError` | `UsageError`, `ShapeError` | a latent has the wrong number of values, or values that are not finite |
"""


class ManifoldError(Exception):
    """Base of all errors of this package."""

    def __str__(self) -> str:
        """Return the message without the quotes that `KeyError` would add."""
        return Exception.__str__(self)


class FileFormatError(ManifoldError, ValueError):
    """The content of a file is not in the format that its name promises."""


class ShapeError(ManifoldError, ValueError):
    """An array has the wrong shape or dtype, or holds values that are not finite."""


class BandMismatchError(ManifoldError, ValueError):
    """Two objects that must have the same bands have different ones."""


class LibraryError(ManifoldError, ValueError):
    """A library has an unsupported version, is damaged, or cannot be written."""


class MissingLibraryError(LibraryError, FileNotFoundError):
    """A library does not exist."""


class ModelError(ManifoldError, ValueError):
    """A model file has an unsupported version, is damaged, or does not fit its library."""


class MissingModelError(ModelError, FileNotFoundError):
    """A model does not exist."""


class FetchError(ManifoldError, OSError):
    """A download failed, or its size or hash is wrong."""


class NumericalError(ManifoldError, ArithmeticError):
    """A factorisation or an iteration failed."""


class RendererError(ManifoldError, RuntimeError):
    """Mitsuba, which rendering needs, is missing, or lacks the backend that an evaluation needs."""


class MissingPackageError(ManifoldError, ImportError):
    """An optional package is not installed; the message names the extra that installs it."""


class UsageError(ManifoldError, ValueError):
    """A value given by the user is invalid."""


class MissingFileError(UsageError, FileNotFoundError):
    """A file does not exist."""


class FileAccessError(UsageError, OSError):
    """A file or folder cannot be read, or cannot be written."""


class UnknownNameError(UsageError, KeyError):
    """A name is unknown."""


class LatentError(UsageError, ShapeError):
    """A latent coordinate has the wrong number of values, or values that are not finite."""


EXTENSIONS: dict[str, str] = {}
"""Packages that add entries to the registries, by the top-level module of their entry points."""


def extension_of(error: BaseException) -> str | None:
    """Return the package of an entry point whose code raised an exception, or called what raised it; else None."""
    trace = error.__traceback__
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__")).partition(".")[0]
        if module in EXTENSIONS:
            return EXTENSIONS[module]
        trace = trace.tb_next
    return None


def in_words(error: BaseException) -> str:
    """Return the message that a user sees for an error that ends a command."""
    if isinstance(error, ManifoldError):
        return str(error)
    if (package := extension_of(error)) is not None:
        return f"the package {package} failed ({type(error).__name__}: {error}); report it there, or uninstall it"
    if isinstance(error, MemoryError):
        return "out of memory; close other programs, or use a smaller library"
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}; check the path, its permissions and the free space"
    return f"internal error: {type(error).__name__}: {error}; run again with --debug and report it"
