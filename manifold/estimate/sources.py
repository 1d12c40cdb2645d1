"""Parses the materials that a user names: a file, a material of a library, or a point on a map."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from manifold.core import shipped
from manifold.core.errors import ManifoldError, MissingFileError, ModelError, UnknownNameError
from manifold.core.names import names_like
from manifold.core.records import BsdfFile
from manifold.formats.recognition import require_no_export
from manifold.io_rgl import material_name, read_bsdf
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.places import Place, PlaceLike, is_place

if TYPE_CHECKING:
    from manifold.model.manifold import Manifold

_FILE_ENDING = re.compile(r"\.[A-Za-z]\w*")


@dataclass(frozen=True)
class FileSource:
    """A file of any supported format, or a folder."""

    path: Path

    @property
    def name(self) -> str:
        """Return the name of the material, which follows from the file's name."""
        return material_name(self.path)

    def __str__(self) -> str:
        return str(self.path)


@dataclass(frozen=True)
class LibrarySource:
    """A measured material of a library."""

    library: Path
    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class PlaceSource:
    """The prediction at a point on the map of a model.

    Attributes:
        library: path of the model's library, if it was moved.
    """

    model: Path
    place: PlaceLike
    library: Path | None = None
    colour: ColourChoice = NEAREST

    @property
    def name(self) -> str:
        """Return the name for files of this prediction."""
        return "predicted"

    def __str__(self) -> str:
        if isinstance(self.place, str):
            return self.place
        latent = self.place.latent if isinstance(self.place, Place) else self.place
        return ", ".join(f"{v:.4g}" for v in latent)


MaterialSource = FileSource | LibrarySource | PlaceSource
"""A material in one of the forms that commands accept."""


def parse_source(text: str, model: Path, library: Path | None = None) -> MaterialSource:
    """Parse a text as a file, a material of the library, a folder, or a point on the map, whichever fits first.

    A point is coordinates separated by commas, or `FROM:TO:T`. For files, the model need not exist. `library`
    replaces the model's library.
    """
    text = text.strip()
    path = Path(text)
    if os.path.isfile(path) or shipped.is_elsewhere(path):
        require_no_export(path)
        return FileSource(path)
    failure: ManifoldError | None = None
    looks_like_file = "/" in text or _FILE_ENDING.fullmatch(path.suffix) is not None
    try:
        known, names = _names(model, library)
        unknown = (
            f"neither a file, nor a material of {known.name} ({names_like(names, text)}), nor a point on a map (X,Y or "
            "FROM:TO:T)"
        )
        if known != shipped.BUILT_IN and text in shipped.about()["materials"]:
            unknown += f"; the built-in library holds it: add {'-M' if library is None else '-L'} built-in"
    except ManifoldError as error:
        known, names, failure = Path(), (), error
        unknown = f"neither a file nor a point on a map, and there is no library to look it up in: {error}"
    if text in names:
        return LibrarySource(known, text)
    if os.path.exists(path):
        return FileSource(path)
    if not looks_like_file and is_place(text):
        return PlaceSource(model, text, library)
    if looks_like_file:
        raise MissingFileError(
            f"{text}: no such file or folder; give a file, a material of a library, or a point on a map"
        )
    if isinstance(failure, ModelError):
        raise failure
    raise UnknownNameError(f"'{text}' is {unknown}")


def read_measured(source: FileSource | LibrarySource) -> BsdfFile:
    """Return the RGL file of a measured material, in the orientation in which it was measured."""
    if isinstance(source, FileSource):
        return read_bsdf(source.path)
    from manifold.library.store import Library

    return replace(Library(source.library).read(source.name), rotation_rad=0.0)


def place_of(source: MaterialSource | PlaceLike, model: Manifold) -> Place:
    """Return the point of a source on a map; materials that are not on the map are located by `Manifold.embed`."""
    if isinstance(source, LibrarySource) and source.name in model.names:
        return model.place(source.name)
    if isinstance(source, FileSource | LibrarySource):
        from manifold.model.location import locate

        located = locate(model, read_measured(source))
        return Place(located.latent, rotation_rad=located.rotation_rad)
    return model.place(source.place if isinstance(source, PlaceSource) else source)


def _names(model: Path, library: Path | None) -> tuple[Path, tuple[str, ...]]:
    """Return the library in which names are looked up, and its names."""
    from manifold.library.store import Library

    if shipped.is_built_in(library or model):  # not opened, which would say that it is used
        return shipped.BUILT_IN, tuple(shipped.about()["materials"])
    if library is None:
        from manifold.model.model_file import read_model

        library = read_model(model).library
    return library, Library(library).names
