"""What commands for many materials begin with: files, folders, patterns such as `*.xlsx`, and libraries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.disk import begins_with
from manifold.errors import ManifoldError, UsageError
from manifold.estimate.samples import safe_name
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource, PlaceSource
from manifold.formats import registry
from manifold.formats.tensor_file import MAGIC
from manifold.io_rgl import material_name
from manifold.library.identity import file_sha256
from manifold.library.importing import find_files
from manifold.library.store import Library
from manifold.model.manifold import load_model

FIT = ".fit.json"


@dataclass(frozen=True)
class Input:
    """A material, or one of the samples of a file.

    Attributes:
        name: of what is made of it.
        source: where it is.
        sample: which, in a file of several.
    """

    name: str
    source: MaterialSource
    sample: str | None = None

    def __str__(self) -> str:
        return str(self.source) if self.sample is None else f"{self.source}: {self.sample}"

    def made_of(self) -> dict[str, Any]:
        """What its content depends on, plain values."""
        source = self.source
        if isinstance(source, FileSource):
            return {"file": file_sha256(source.path), "sample": self.sample}
        if isinstance(source, LibrarySource):
            return {"material": Library(source.library).attributes(source.name).content_sha256}
        loaded = load_model(source.model, source.library)
        place, colour = loaded.place(source.place), source.colour.made_of()
        hashes = {"model": file_sha256(source.model), "library": loaded.library.content_hash}
        return hashes | {"latent": place.latent.tolist(), "path": place.path, "colour": colour}


def is_rgl(path: Path) -> bool:
    """Whether a file is named as one of the RGL database, or begins like one."""
    return path.suffix == ".bsdf" or begins_with(path, MAGIC)


def is_rendered(path: Path) -> bool:
    """Whether a file is named as an RGL file or a fit."""
    return path.suffix == ".bsdf" or path.name.endswith(FIT)


def is_many(sources: Sequence[MaterialSource]) -> bool:
    """Whether sources are several, or a folder or library, which stands for several."""
    return len(sources) > 1 or any(isinstance(one, FileSource) and one.path.is_dir() for one in sources)


def find_inputs(
    sources: Iterable[MaterialSource], is_wanted: Callable[[Path], bool] = is_rgl, *, samples: bool = False
) -> list[Input]:
    """The materials of sources, none read yet.

    Args:
        sources: files, folders, which are searched at every depth, libraries, materials of these, and places.
        is_wanted: which files of folders.
        samples: whether every sample of an instrument's file is a material.
    Raises:
        UsageError: a source is missing, or a folder holds none.
        LibraryError: a library is damaged.
    """
    found: list[Input] = []
    for source in sources:
        if isinstance(source, PlaceSource):
            found.append(Input(str(source).replace(":", "_"), source))
        elif isinstance(source, LibrarySource):
            found.append(Input(source.name, source))
        elif (source.path / "zarr.json").is_file():
            names = Library(source.path).names
            found += [Input(name, LibrarySource(source.path, name)) for name in names]
        else:
            for path in find_files([source.path], is_wanted, "suitable file"):
                found += _samples_of(path) if samples and not is_rendered(path) else [_of_file(path)]
    return list(dict.fromkeys(found))


def _of_file(path: Path) -> Input:
    is_known = is_rendered(path)
    name = material_name(Path(path.name.removesuffix(FIT))) if is_known else safe_name(path.stem)
    return Input(name, FileSource(path))


def _samples_of(path: Path) -> list[Input]:
    try:
        names = [record.name for record in registry.read_all(path)]
    except ManifoldError:  # which whatever reads its values is told again
        names = []
    several = [Input(safe_name(name), FileSource(path), name) for name in names]
    return several if len(several) > 1 else [_of_file(path)]


def require_apart(sources: Iterable[Path], folder: Path) -> None:
    """Raise UsageError where a folder to be written to is one that is searched, or that a file is read from."""
    for source in sources:
        read = source if source.is_dir() else source.parent
        if read.exists() and folder.exists() and read.samefile(folder):
            raise UsageError(f"{folder}: is the folder of what is read; name another one for what is written")
