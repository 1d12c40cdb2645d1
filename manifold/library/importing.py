"""Import of files into a library; every finished material is added atomically."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Literal, TypeVar

from manifold.errors import FileFormatError, LibraryError, ManifoldError, UsageError
from manifold.io_rgl import read_bsdf
from manifold.library import location, staging
from manifold.library.identity import alike, file_sha256, require_material_name
from manifold.library.store import Library
from manifold.library.writing import make_store, read_bands, write_material
from manifold.records import Bands, BsdfFile, Progress
from manifold.system import interrupts

Outcome = Literal["imported", "skipped", "replaced"]

_MOST_MAPPED = 4096

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class ImportResult:
    """What became of each file.

    Attributes:
        imported: names of new materials, sorted.
        skipped: names of materials that were there already with the same SHA-256, sorted.
        replaced: names of materials whose content was exchanged, sorted.
        failed: why a file was left out, by its path; all the others were imported.
    """

    imported: tuple[str, ...]
    skipped: tuple[str, ...]
    replaced: tuple[str, ...]
    failed: dict[str, str]


@dataclass(frozen=True)
class _Source:
    """A file to import. Of many, only some stay mapped: each one takes a file descriptor."""

    path: Path
    sha256: str
    name: str
    bands: Bands
    mapped: BsdfFile | None

    def read(self) -> BsdfFile:
        """The file, unchanged since it was hashed."""
        if self.mapped is not None:
            return self.mapped
        file = read_bsdf(self.path)
        if file_sha256(self.path) != self.sha256:
            raise FileFormatError(f"{self.path}: changed while it was imported; import again")
        return file


def import_files(
    library_path: Path | str,
    sources: Iterable[Path | str] | Path | str,
    *,
    replace: bool = False,
    on_progress: Progress | None = None,
) -> ImportResult:
    """Import RGL files into a library, which is made with the bands of the first file if there is none.

    A material appears in the library in one step, when it is whole: a killed import leaves exactly the
    finished ones, and importing again adds the rest. One bad file stops no other.

    Args:
        library_path: the library.
        sources: `.bsdf` files, or folders searched at every depth for `*.bsdf`; one of them, or several.
        replace: exchange materials that are there under the same name with other content.
        on_progress: called with (done, total, name) after each file.
    Returns:
        What became of each file; `failed` must be looked at.
    Raises:
        UsageError: a source does not exist, a folder holds no `*.bsdf`, or the library would lie in another one.
        BandMismatchError: a file has other bands than the library or the first file; nothing was written.
        LibraryError: what is there is no library, another process writes to it, or the disk is full.
    """
    paths = _find([sources] if isinstance(sources, str | Path) else sources)
    library = location.resolved(library_path)
    location.require_outside_libraries(library)
    expected = Library.open(library).bands if library.exists() else None
    report = _Report(2 * len(paths), on_progress)
    loaded = _load(paths, report)
    _require_one_grid(loaded, expected, library)
    if loaded:
        _make_folder(library.parent)
        with staging.writing(library) as staged:
            if not library.exists():
                make_store(library, loaded[0].bands, staged)
            opened = Library(library, read_bands(library, library))
            _require_one_grid(loaded, opened.bands, library)  # Another process may have made it meanwhile.
            _store_all(opened, loaded, staged, replace, report)
    return report.result()


class _Report:
    """Collects outcomes and counts progress, from several threads at once."""

    def __init__(self, total: int, on_progress: Progress | None) -> None:
        self.outcomes: dict[str, Outcome] = {}
        self.failed: dict[str, str] = {}
        self._done, self._total, self._on_progress = 0, total, on_progress
        self._mutex = threading.Lock()

    def step(self, path: Path, steps: int = 1) -> None:
        with self._mutex:
            self._done += steps
            if self._on_progress:
                self._on_progress(self._done, self._total, path.name)

    def fail(self, path: Path, message: str) -> None:
        self.failed[str(path)] = message

    def result(self) -> ImportResult:
        def names(kind: Outcome) -> tuple[str, ...]:
            return tuple(sorted(name for name, outcome in self.outcomes.items() if outcome == kind))

        failed = dict(sorted(self.failed.items()))
        return ImportResult(names("imported"), names("skipped"), names("replaced"), failed)


def _find(sources: Iterable[Path | str]) -> list[Path]:
    """All files named by sources, each once, in order."""
    found: dict[Path, None] = {}
    for source in map(Path, sources):
        if source.is_dir():
            inside = sorted(path for path in source.rglob("*.bsdf") if path.is_file())
            if not inside:
                raise UsageError(f"{source}: holds no .bsdf file; name a folder that does, or the files")
            found.update(dict.fromkeys(inside))
        elif source.exists():
            found[source] = None
        else:
            raise UsageError(f"{source}: no such file or folder")
    if not found:
        raise UsageError("nothing to import; name .bsdf files or folders that hold some")
    return list(found)


def _load(paths: Sequence[Path], report: _Report) -> list[_Source]:
    """Map, check and hash every file; the bad ones are reported and left out."""
    mapped, most = count(), _most_mapped()

    def load(path: Path) -> _Source | None:
        try:
            file = read_bsdf(path)
            require_material_name(file.name)
            kept = file if next(mapped) < most else None
            source = _Source(path, file_sha256(path), file.name, file.bands, kept)
            report.step(path)
            return source
        except ManifoldError as error:
            report.fail(path, str(error))
        except OSError as error:
            report.fail(path, f"{path.name}: cannot be read ({error.strerror})")
        report.step(path, 2)
        return None

    return [source for source in _in_threads(load, paths) if source]


def _most_mapped() -> int:
    """Number of files that may stay mapped: half of the process's limit of open files."""
    try:
        import resource
    except ImportError:  # Windows
        return 256
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return _MOST_MAPPED if soft == resource.RLIM_INFINITY else min(_MOST_MAPPED, soft // 2)


def _require_one_grid(loaded: Sequence[_Source], expected: Bands | None, library: Path) -> None:
    for source in loaded:
        expected = expected or source.bands
        remedy = f"import it into a library of its own, not into {library.name}"
        expected.require_same(source.bands, source.path.name, remedy)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LibraryError(f"{folder}: cannot make this folder ({error.strerror})") from error


def _store_all(
    library: Library, loaded: Sequence[_Source], staged: Path, replace: bool, report: _Report
) -> None:
    tasks = _one_per_name(loaded, report)
    spellings = {alike(name): name for name in library.names}

    def store(source: _Source) -> None:
        def done(outcome: Outcome) -> None:
            report.outcomes[source.name] = outcome
            report.step(source.path)

        try:
            outcome = _outcome(library, source, replace, spellings)
            if outcome == "skipped":
                done(outcome)
                return
            folder = staged / source.name
            write_material(folder, source.read(), source.path.name, source.sha256)
            publisher.add(folder, library.path / "materials" / source.name, partial(done, outcome))
        except ManifoldError as error:
            report.fail(source.path, str(error))
            report.step(source.path)

    try:
        with staging.Publisher(library.path) as publisher:
            _in_threads(store, tasks)
    except OSError as error:
        raise LibraryError(
            f"{library.path.name}: writing failed ({error.strerror}) with {len(report.outcomes)} of "
            f"{len(tasks)} materials done; those are whole: make room or check permissions, and import again"
        ) from error


def _one_per_name(loaded: Sequence[_Source], report: _Report) -> list[_Source]:
    """Each material once; of two files with one name, but for case, and different content, the first."""
    chosen: dict[str, _Source] = {}
    for source in loaded:
        first = chosen.setdefault(alike(source.name), source)
        if first is source:
            continue
        if first.sha256 != source.sha256 or first.name != source.name:
            report.fail(
                source.path, f"{source.path}: same name as {first.path}, other content; rename one of them"
            )
        report.step(source.path)
    return list(chosen.values())


def _outcome(library: Library, source: _Source, replace: bool, spellings: Mapping[str, str]) -> Outcome:
    """Whether a file is imported, replaced or skipped. Raises: UsageError: its name belongs to another material."""
    name = source.name
    if spellings.get(alike(name), name) != name:
        raise UsageError(
            f"{source.path.name}: the library has '{spellings[alike(name)]}', which some file systems do not "
            f"distinguish from '{name}'; rename the file"
        )
    known = library.attributes(name) if name in library else None
    if known and known.sha256 == source.sha256:
        return "skipped"
    if known and not replace:
        raise UsageError(
            f"{source.path.name}: '{name}' is in the library with SHA-256 {known.sha256[:12]}..., "
            f"this file has {source.sha256[:12]}...; replace it (replace=True, --replace), or rename the file"
        )
    return "replaced" if known else "imported"


def _in_threads(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Hashing, copying and writing release the interpreter's lock, so threads are enough."""
    pool = ThreadPoolExecutor(min(8, os.cpu_count() or 1))
    try:
        return list(pool.map(function, items))  # which leaves out what has not begun when one fails
    finally:
        with interrupts.deferred():
            pool.shutdown()
