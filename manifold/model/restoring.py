"""Validation of the settings and latent spaces of model files, and of their libraries."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from manifold.errors import LibraryError, ModelError, UsageError
from manifold.library.store import Library
from manifold.model.blend_space import BlendSpace
from manifold.model.latent_space import LatentSpace
from manifold.model.left_out import LeftOut
from manifold.model.material_space import MaterialSpace
from manifold.model.model_file import ModelRecord, damaged
from manifold.model.settings import Settings

SPACES: dict[str, type[LatentSpace]] = {space.kind: space for space in (BlendSpace, MaterialSpace)}
"""The kinds of latent space, by name."""


def open_library(path: Path, stored: ModelRecord, library: Library | Path | str | None) -> Library:
    """The library of a model file.

    Args:
        path: of the model.
        stored: its content.
        library: path of the library, if it was moved.
    Raises:
        LibraryError: it is not there, lacks materials of the model, or has other bands.
    """
    if library is None:
        library = stored.library
        if not library.exists():
            raise LibraryError(f"{path}: its library is not at {library}; say where it is now")
    if not isinstance(library, Library):
        library = Library(library)
    missing = sorted(set(stored.names) - set(library.names))
    if missing:
        shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        raise LibraryError(
            f"{library.path.name} lacks {len(missing)} of the {len(stored.names)} materials of {path.name} "
            f"({shown}); import them again, name the right library, or embed again"
        )
    if stored.n_bands not in (None, library.bands.count):
        raise LibraryError(
            f"{library.path.name} has {library.bands}, {path.name} was fitted to {stored.n_bands} bands; "
            "name the right library, or embed again"
        )
    return library


def restore(path: Path, stored: ModelRecord) -> tuple[Settings, LatentSpace, LeftOut | None]:
    """Settings, latent space, and errors of left-out materials of a model file.

    Raises:
        ModelError: they do not fit each other.
    """
    try:
        settings = Settings(**{f.name: stored.settings[f.name] for f in fields(Settings)})
        space = SPACES[settings.kind].from_arrays(stored.arrays, settings.covariance(), stored.n_bands or 0)
        expected = (len(stored.names), settings.latent_dim)
        if space.X.shape != expected:
            raise ValueError(f"dataset 'X' has shape {space.X.shape}, expected {expected}")
        left_out = LeftOut.from_arrays(stored.arrays, space)
    except UsageError as error:
        raise ModelError(f"{path}: fitted with {error}; embed the library again") from error
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise damaged(path, error) from error
    return settings, space, left_out
