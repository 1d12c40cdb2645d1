"""Many exports into one folder, resumed where an earlier run ended: a library's materials, or a folder's files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from manifold.errors import ManifoldError, UsageError
from manifold.fitting.exports.targets import Target
from manifold.io_rgl import material_name
from manifold.library import Library
from manifold.library.identity import file_sha256, printable_name, require_material_name
from manifold.records import Progress
from manifold.system.stages import with_progress
from manifold.workflows.exports import (
    ExportOutcome,
    Subject,
    export,
    subject_of,
    subject_of_file,
)
from manifold.workflows.output_index import OutputIndex


def export_all(
    source: Path,
    target: Target,
    folder: Path,
    on_progress: Progress | None = None,
    *,
    is_direct: bool = False,
    check: Callable[[Path], None] | None = None,
) -> list[ExportOutcome]:
    """Write every material of a library, or every `.bsdf` file and fit of a folder; what is done is left.

    Args:
        source: the library or the folder; of the folder, at every depth.
        target: for all.
        folder: where to; made if missing. Its `exports.json` names what is done; until the end, `exports.journal` does.
        on_progress: called after each material.
        is_direct: as in `exports.export`.
        check: called before a file is replaced; raises UsageError where it may not be.
    Returns:
        One outcome per material; one that cannot be exported does not stop the others.
    Raises:
        UsageError: there is nothing to export, or the folder cannot be used.
    """
    subjects = dict(_subjects(source))
    if not subjects:
        raise UsageError(
            f"{source}: neither a library nor a folder with .bsdf files or fits; name another source"
        )
    if folder.suffix.lower() == target.suffix and not folder.is_dir():
        raise UsageError(f"{folder}: named like a file, expected a folder for {len(subjects)} exports")
    outcomes = []
    with OutputIndex(folder, "exports") as index:
        for name, (identity, read) in with_progress(subjects.items(), on_progress, lambda item: item[0]):
            path = folder / f"{name}{target.suffix}"
            made_of = {"material": identity, "target": target.name, "direct": is_direct}
            known = index.result(path, made_of)
            if known is not None:
                outcomes.append(ExportOutcome(name, path, known, was_there=True))
            else:
                outcomes.append(_export_one(name, read, target, path, is_direct, check))
                made = outcomes[-1].export
                if made is not None:
                    index.add(path, made_of, made)
    return outcomes


def _export_one(
    name: str, read: Callable[[], Subject], target: Target, path: Path, is_direct: bool,
    check: Callable[[Path], None] | None,
) -> ExportOutcome:  # fmt: skip
    try:
        require_material_name(name)
        if check is not None:
            check(path)
        return replace(export(read(), target, path, is_direct=is_direct), name=name)
    except ManifoldError as error:
        return ExportOutcome(printable_name(name), path, None, failure=str(error))


def _subjects(source: Path) -> Iterator[tuple[str, tuple[str, Callable[[], Subject]]]]:
    """Name, identity and reader of every material of a source, none read yet."""
    if (source / "zarr.json").is_file():
        library = Library.open(source)
        for name in library.names:
            info = library.attributes(name)
            described = {"library": source.name, "file": info.source_file, "sha256": info.sha256}
            yield name, (info.content_sha256, partial(_read_material, library, name, described))
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
        yield name, ("".join(map(file_sha256, used)), partial(subject_of, *used))


def _read_material(library: Library, name: str, described: dict[str, Any]) -> Subject:
    return subject_of_file(library.read(name), described)
