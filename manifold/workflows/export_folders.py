"""Many exports into one folder, resumed where an earlier run ended: a library's materials, or a folder's files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from manifold.errors import UsageError
from manifold.fitting.exports.targets import Target
from manifold.io_rgl import material_name
from manifold.library import Library
from manifold.library.identity import file_sha256
from manifold.workflows.batch import Batch, Outcome, Task
from manifold.workflows.exports import (
    Subject,
    export,
    subject_in_library,
    subject_of,
)


class _Source(NamedTuple):
    """A material to export: its name, what identifies its content, and what reads it."""

    name: str
    identity: str
    read: Callable[[], Subject]

    def __str__(self) -> str:
        return self.name


def export_all(
    source: Path,
    target: Target,
    folder: Path,
    *,
    is_mapped: bool = False,
    with_pictures: bool = False,
) -> list[Outcome[_Source]]:
    """Write every material of a library, or every `.bsdf` file and fit of a folder; what is done is left.

    Args:
        source: the library or the folder; of the folder, at every depth.
        target: for all.
        folder: where to; made if missing. Its `exports.jsonl` names what is done.
        is_mapped: as in `exports.export`.
        with_pictures: whether to draw each material beside the target's model, into NAME.png.
    Returns:
        One outcome per material; one that cannot be exported does not stop the others.
    Raises:
        UsageError: there is nothing to export, or the folder cannot be used.
    """
    subjects = list(_subjects(source))
    if not subjects:
        raise UsageError(
            f"{source}: neither a library nor a folder with .bsdf files or fits; name another source"
        )
    if folder.suffix.lower() == target.suffix and not folder.is_dir():
        raise UsageError(f"{folder}: named like a file, expected a folder for {len(subjects)} exports")

    def made_of(source: _Source) -> dict[str, Any]:
        return {"material": source.identity, "target": target.name, "mapped": is_mapped}

    make = partial(_export, target=target, is_mapped=is_mapped, with_pictures=with_pictures)
    todo = [Task(s.name, folder / f"{s.name}{target.suffix}", s) for s in subjects]
    return Batch(folder, "exports").run(todo, make, made_of)


def _export(
    source: _Source, path: Path, *, target: Target, is_mapped: bool, with_pictures: bool
) -> dict[str, Any]:
    picture = path.with_suffix(".png") if with_pictures else None
    return export(source.read(), target, path, is_mapped=is_mapped, picture=picture).content or {}


def _subjects(source: Path) -> Iterator[_Source]:
    """Every material of a source, none read yet."""
    if (source / "zarr.json").is_file():
        library = Library(source)
        for name in library.names:
            yield _Source(
                name, library.attributes(name).content_sha256, partial(subject_in_library, library, name)
            )
        return
    fits: dict[str, Path] = {}
    files: dict[str, Path] = {}
    for path in sorted(source.rglob("*")):
        kind = {".bsdf": files, ".json": fits if path.name.endswith(".fit.json") else None}.get(path.suffix)
        if kind is None or not path.is_file():
            continue
        name = material_name(Path(path.name.removesuffix(".fit.json")))
        if kind.setdefault(name, path) != path:
            raise UsageError(f"{path} and {kind[name]} have the same name; export them into two folders")
    for name in sorted({*fits, *files}):
        used = [path for path in (fits.get(name), files.get(name)) if path is not None]
        yield _Source(name, "".join(map(file_sha256, used)), partial(subject_of, *used))
