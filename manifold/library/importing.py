"""Imports files into a library; each material is added atomically."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from dataclasses import replace as changed
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Literal, TypeVar

import numpy as np

from manifold.brdf.consistency import check_consistency
from manifold.brdf.orientation import rotation_of
from manifold.core import progress, work
from manifold.core.errors import LibraryError, ManifoldError, MissingFileError, UsageError
from manifold.core.names import counted, first_few
from manifold.core.records import Bands
from manifold.formats.recognition import counts_as_readings, is_rgl
from manifold.io_rgl import read_bsdf
from manifold.library import staging
from manifold.library.identity import (
    file_sha256,
    require_material_name,
    require_outside_libraries,
    require_tolerance,
)
from manifold.library.staging import make_store, write_material
from manifold.library.store import Library, require_folder

_MANY_TASKS = 64  # number of tasks from which on they have several files
_MOST_TOGETHER = 16  # files of a task

Rotation = float | Literal["auto"] | None
Outcome = Literal["imported", "skipped", "replaced"]

T = TypeVar("T")


class InconsistentFileWarning(UserWarning):
    """Warns that values of an imported file disagree with each other or are physically impossible."""


@dataclass(frozen=True)
class ImportResult:
    """The outcome of an import for each file.

    Attributes:
        imported: names of new materials, sorted.
        skipped: names of materials that the library already held with the same SHA-256, sorted.
        replaced: names of materials whose content was replaced, sorted.
        failed: reason why a file was not imported, by its path; all other files were imported.
        inconsistent: faults in the values of imported files, by path; see `brdf.consistency`.
        readings: files in the given folders that hold readings, such as workbooks, sorted; they are not imported.
    """

    imported: tuple[str, ...]
    skipped: tuple[str, ...]
    replaced: tuple[str, ...]
    failed: dict[str, str]
    inconsistent: dict[str, tuple[str, ...]]
    readings: tuple[Path, ...] = ()


@dataclass(frozen=True)
class _Source:
    """A file to import, checked and hashed."""

    path: Path
    sha256: str
    name: str
    bands: Bands
    rotation_rad: float | None
    findings: tuple[str, ...]


def import_files(
    library_path: Path | str,
    sources: Iterable[Path | str] | Path | str,
    *,
    replace: bool = False,
    tolerance: float | None = None,
    rotation_rad: Rotation = None,
    workers: Executor | None = None,
) -> ImportResult:
    """Import RGL files into a library; a new library is created with the bands of the first file.

    Each material appears in the library only when it is complete. If the import is killed, the finished materials
    stay, and importing again adds the rest. If a file cannot be read, the others are still imported. A file with
    inconsistent values is imported with an `InconsistentFileWarning`.

    Args:
        library_path: path of the library.
        sources: one or several `.bsdf` files, or folders that are searched recursively for `*.bsdf`.
        replace: replace materials that have the same name but other content or another form of storage.
        tolerance: largest ball error (CIEDE2000) allowed for compact storage; None stores the files unchanged.
        rotation_rad: azimuth, from -pi to pi, by which anisotropic specimens were turned when they were measured; it
            is stored, and evaluation turns the material back. "auto" estimates it from the normals; see
            `manifold.brdf.orientation`.
        workers: executor that checks files and writes materials; None uses threads of this process.

    Returns:
        The outcome for each file; check `failed`, because a failed file raises no exception.

    Raises:
        UsageError: a source does not exist, a folder holds no `*.bsdf`, the library would lie in another library, or
            the rotation is out of range.
        BandMismatchError: a file has other bands than the library or the first file; nothing was written.
        LibraryError: the path is not a library, another process is writing to it, or the disk is full.
        ManifoldError: a worker process ended unexpectedly.
    """
    if tolerance is not None:
        require_tolerance(tolerance)
    if isinstance(rotation_rad, float) and not abs(rotation_rad) <= np.pi:
        raise UsageError(f"rotation is {rotation_rad:g}, expected -pi to pi, in radians")
    given = [Path(source) for source in ([sources] if isinstance(sources, str | Path) else sources)]
    paths = find_files(given)
    require_folder(library_path)
    library = Path(library_path).expanduser().resolve()  # staging beside the library, not beside a link
    require_outside_libraries(library)
    is_new = not library.exists() or (os.path.ismount(library) and not staging.contents(library))
    expected = None if is_new else Library(library).bands
    report = _Report(2 * len(paths))
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as threads:
        workers = workers or threads
        stored = frozenset[str]()  # SHA-256 of files
        if not is_new:
            there = Library(library)
            stored = frozenset(there.attributes(name).sha256 for name in there.names)
        loaded = _load(paths, rotation_rad, stored, workers, report)
        for source in loaded:
            expected = expected or source.bands
            remedy = f"import it into a library of its own, not into {library.name}"
            expected.require_same(source.bands, source.path.name, remedy)
        for source in loaded:
            if source.findings:
                first, *others = source.findings
                more = f", and {counted(len(others), 'other finding')}" if others else ""
                warnings.warn(
                    f"{source.path.name}: {first}{more}; see `manifold info`, and replace it by an intact file",
                    InconsistentFileWarning,
                    stacklevel=2,
                )
        if loaded:
            with staging.writing(library) as staged:
                if is_new:
                    make_store(library, loaded[0].bands, staged)
                chosen = _choose(Library(library), loaded, replace, tolerance, report)
                _store_all(library, chosen, staged, tolerance, workers, report)
                staging.consolidate(library)
    inconsistent = {str(source.path): source.findings for source in loaded if source.findings}
    return changed(report.result(inconsistent), readings=tuple(_readings_in(given)))


def readings_note(paths: Sequence[Path]) -> str:
    """Return a text that names files with readings, and the command that reads them."""
    return f"`manifold complete` reads the readings in {first_few([path.name for path in paths])}"


def _readings_in(sources: Iterable[Path]) -> list[Path]:
    """Return files with readings in the folders among sources, sorted."""
    inside = (path for source in sources if source.is_dir() for path in _walk(source))
    return sorted({path for path in inside if not is_rgl(path) and counts_as_readings(path)})


def find_files(
    sources: Iterable[Path | str],
    is_wanted: Callable[[Path], bool] = is_rgl,
    what: str = ".bsdf file",
) -> list[Path]:
    """Return the wanted files among files and folders, each once and in order.

    Folders are searched recursively, in sorted order, without libraries and hidden folders in them. `what` describes
    the wanted files in messages.
    """
    found: dict[Path, None] = {}
    for source in map(Path, sources):
        if source.is_dir():
            inside = sorted(
                path for path in _walk(source) if (path.is_file() or path.is_symlink()) and is_wanted(path)
            )
            if not inside:
                remedy = "name a folder that does, or the files"
                if is_wanted is is_rgl and (readings := _readings_in([source])):
                    remedy = readings_note(readings)
                raise MissingFileError(f"{source}: holds no {what}; {remedy}")
            found.update(dict.fromkeys(inside))
        elif source.exists():
            found[source] = None
        else:
            raise MissingFileError(
                f"{source}: no such file or folder; give {what}s, or folders that contain them"
            )
    if not found:
        raise UsageError(f"no file is given; give {what}s, or folders that contain them")
    return list(found)


def _walk(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        if "zarr.json" in names:
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (Path(parent, name) for name in names)


class _Report:
    """Collects outcomes, and counts progress."""

    def __init__(self, total: int) -> None:
        self.outcomes: dict[str, Outcome] = {}
        self.failed: dict[str, str] = {}
        self._done, self._total = 0, total

    def step(self, path: Path, steps: int = 1) -> None:
        self._done += steps
        progress.report(self._done, self._total, path.name)

    def fail(self, path: Path, message: str) -> None:
        self.failed[str(path)] = message

    def result(self, inconsistent: dict[str, tuple[str, ...]]) -> ImportResult:
        def names(kind: Outcome) -> tuple[str, ...]:
            return tuple(sorted(name for name, outcome in self.outcomes.items() if outcome == kind))

        failed = dict(sorted(self.failed.items()))
        return ImportResult(names("imported"), names("skipped"), names("replaced"), failed, inconsistent)


def _load(
    paths: Sequence[Path], rotation_rad: Rotation, stored: frozenset[str], workers: Executor, report: _Report
) -> list[_Source]:
    """Check and hash every file; the bad ones are reported and left out."""
    tasks = _in_groups(paths)
    loaded: dict[int, list[_Source]] = {}
    for k, checked, _ in work.run(partial(_check, rotation_rad=rotation_rad, stored=stored), tasks, workers):
        assert checked is not None
        for path, source in zip(tasks[k], checked, strict=True):
            if isinstance(source, str):
                report.fail(path, source)
            report.step(path, 2 if isinstance(source, str) else 1)
        loaded[k] = [source for source in checked if isinstance(source, _Source)]
    return [source for k in range(len(tasks)) for source in loaded[k]]


def _check(paths: Sequence[Path], *, rotation_rad: Rotation, stored: frozenset[str]) -> list[_Source | str]:
    """Check files; return the record of each, or the reason why it cannot be imported."""
    checked: list[_Source | str] = []
    for path in paths:
        try:
            file = read_bsdf(path)
            require_material_name(file.name)
            rotation = rotation_rad
            if rotation == "auto" or file.is_isotropic:
                rotation = rotation_of(file) or 0.0
            sha256 = file_sha256(path)
            findings = () if sha256 in stored else check_consistency(file).findings
            checked.append(_Source(path, sha256, file.name, file.bands, rotation, findings))
        except ManifoldError as error:
            checked.append(str(error))
        except OSError as error:
            checked.append(f"{path.name}: cannot be read ({error.strerror})")
    return checked


def _choose(
    library: Library, loaded: Sequence[_Source], replace: bool, tolerance: float | None, report: _Report
) -> dict[Outcome, list[_Source]]:
    """Return the files to be stored, as new materials or in place of others, and report the rest."""
    first_of: dict[str, _Source] = {}
    chosen: dict[Outcome, list[_Source]] = {"imported": [], "replaced": []}
    for source in loaded:
        known = library.attributes(source.name) if source.name in library else None
        if source.rotation_rad is None:
            source = changed(source, rotation_rad=known.rotation_rad if known else 0.0)
        # On some file systems, case does not count.
        first = first_of.setdefault(source.name.casefold(), source)
        is_same = known is not None and known.sha256 == source.sha256
        is_same_form = (
            known is not None
            and (known.accuracy and known.accuracy.tolerance) == tolerance
            and known.rotation_rad == source.rotation_rad
        )
        if first is not source:
            if (first.name, first.sha256) != (source.name, source.sha256):
                report.fail(
                    source.path,
                    f"{source.path}: same name as {first.path}, other content; rename one of them",
                )
        elif is_same and (is_same_form or not replace):
            report.outcomes[source.name] = "skipped"
        elif known is not None and not replace:
            report.fail(
                source.path,
                f"{source.path.name}: '{source.name}' is in the library with SHA-256 {known.sha256[:12]}..., "
                f"this file has {source.sha256[:12]}...; replace it (replace=True), or rename the file",
            )
        else:
            chosen["imported" if known is None else "replaced"].append(source)
            continue
        report.step(source.path)
    return chosen


def _store_all(
    library: Path, chosen: dict[Outcome, list[_Source]], staged: Path, tolerance: float | None, workers: Executor,
    report: _Report,
) -> None:  # fmt: skip
    tasks = _in_groups([(outcome, source) for outcome, sources in chosen.items() for source in sources])
    stopped = None
    store = partial(_store, library=library, staged=staged, tolerance=tolerance)
    for k, failures, stop in work.run(store, [[s for _, s in t] for t in tasks], workers):
        stopped = stopped or stop
        for (outcome, source), failure in zip(tasks[k], failures or (), strict=False):
            if failure is None:
                report.outcomes[source.name] = outcome
            else:
                report.fail(source.path, failure)
            report.step(source.path)
    if stopped is not None:
        raise LibraryError(
            f"{library.name}: writing failed ({stopped}) with {len(report.outcomes)} materials finished, which "
            "are complete: free some space or check permissions, and import again"
        )


def _store(
    sources: Sequence[_Source], *, library: Path, staged: Path, tolerance: float | None
) -> list[str | None]:
    """Write materials into a library, each in one step when it is whole; of each, why it was not."""
    return [_stored(source, library, Path(mkdtemp(dir=staged)), tolerance) for source in sources]


def _stored(source: _Source, library: Path, staged: Path, tolerance: float | None) -> str | None:
    file, compact = changed(read_bsdf(source.path), rotation_rad=source.rotation_rad or 0.0), None
    if tolerance is not None:
        from manifold.library import compacting  # which loads what evaluates materials

        try:
            compact = compacting.encode(file, tolerance)
        except LibraryError as error:
            return str(error)
    write_material(staged / source.name, file, source.path.name, source.sha256, compact)
    staging.publish(staged / source.name, library / "materials" / source.name)
    return None


def _in_groups(items: Sequence[T]) -> list[Sequence[T]]:
    """Return groups of items for tasks: groups the size of a task, independent of the number of workers."""
    size = min(max(len(items) // _MANY_TASKS, 1), _MOST_TOGETHER)
    return [items[first : first + size] for first in range(0, len(items), size)]
