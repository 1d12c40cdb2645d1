"""Downloads files of the RGL material database."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote, urlsplit

from manifold import __version__
from manifold.core import progress
from manifold.core.errors import FetchError, FileFormatError, UnknownNameError, UsageError
from manifold.core.extras import require
from manifold.core.names import first_few, names_like
from manifold.io_rgl import read_bsdf
from manifold.library.identity import require_outside_libraries


@dataclass(frozen=True)
class Entry:
    """A file of the database: name, size, checksum, and the number of incident azimuths (1 if isotropic)."""

    name: str
    size_bytes: int | None
    sha256: str | None
    is_isotropic: bool = True
    is_rgb: bool = False

    @property
    def file(self) -> str:
        """Return the name of the file."""
        return f"{self.name}_{'rgb' if self.is_rgb else 'spec'}.bsdf"


@cache
def rgl_table() -> Mapping[str, Entry]:
    """Return the spectral files of the database by name: 51 isotropic, and 11 anisotropic without checksums."""
    data = resources.files("manifold.library")
    with (data / "rgl_isotropic.tsv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines, delimiter="\t"))
    entries = [Entry(row["material"], int(row["size_bytes"]), row["sha256"]) for row in rows]
    names = (data / "rgl_anisotropic.txt").read_text(encoding="utf-8").split()
    entries += [Entry(name, None, None, is_isotropic=False) for name in names]
    return MappingProxyType({entry.name: entry for entry in entries})


@cache
def rgb_table() -> Mapping[str, Entry]:
    """Return the RGB files of isotropic materials by name; 20 of them have checksums."""
    with (resources.files("manifold.library") / "rgl_rgb.tsv").open(encoding="utf-8") as lines:
        sums = {row["material"]: row for row in csv.DictReader(lines, delimiter="\t")}
    entries = []
    for entry in rgl_table().values():
        row = sums.get(entry.name)
        size, sha256 = (None, None) if row is None else (int(row["size_bytes"]), row["sha256"])
        if entry.is_isotropic:
            entries.append(Entry(entry.name, size, sha256, is_rgb=True))
    return MappingProxyType({entry.name: entry for entry in entries})


def select(names: Sequence[str] | None, table: Mapping[str, Entry], anisotropic: bool) -> list[Entry]:
    """Return the entries with the given names, or for None all isotropic ones and, with `anisotropic`, all others.

    For None, RGB files without a known checksum are left out.
    """
    if names is None:
        table = {name: entry for name, entry in table.items() if entry.sha256 or not entry.is_rgb}
        return [entry for entry in table.values() if entry.is_isotropic or anisotropic]
    for name in names:
        if name not in table:
            raise UnknownNameError(f"{name}: no such material in the RGL database; {names_like(table, name)}")
    return [table[name] for name in dict.fromkeys(names)]


BASE_URL = "https://d38rqfq1h7iukm.cloudfront.net/media/materials"
_MOST_BYTES = 1 << 30  # largest file whose size no table knows; those in the database have at most 111 MB
_BLOCK_BYTES = 1 << 18


@dataclass(frozen=True)
class FetchResult:
    """The files of a download.

    Attributes:
        downloaded: paths of new files.
        present: paths of files that existed already.
        without_checksum: names of files without a known checksum; only their structure was checked.
    """

    downloaded: tuple[Path, ...]
    present: tuple[Path, ...]
    without_checksum: tuple[str, ...]


class IncompleteFetchError(FetchError):
    """Raised if some downloads failed; `failed` holds the reasons by material, `result` the other files."""

    def __init__(self, message: str, result: FetchResult, failed: dict[str, str]) -> None:
        super().__init__(message)
        self.result = result
        self.failed = failed


def fetch(
    names: Sequence[str] | None,
    to: Path | str,
    *,
    base_url: str = BASE_URL,
    anisotropic: bool = False,
    rgb: bool = False,
    table: Mapping[str, Entry] | None = None,
    timeout_s: float = 30.0,
    attempts: int = 4,
) -> FetchResult:
    """Download files of the RGL database into a folder: `NAME_spec.bsdf`, or with `rgb` `NAME_rgb.bsdf`.

    A file gets its final name only if its SHA-256 is right. An existing file is kept if its hash is right, and
    replaced otherwise. If a download fails, the other files are still downloaded.

    If `names` is None, all isotropic materials are downloaded; `anisotropic` adds the anisotropic ones (1.2 GB more,
    without known checksums), and `rgb` selects the 20 RGB files whose checksums are known. `table` replaces the
    built-in table. A download stalls if no data arrive for `timeout_s` seconds. Each file is tried `attempts` times.
    """
    if rgb and anisotropic:
        raise UsageError("found rgb and anisotropic, expected one: anisotropic files are spectral")
    known = (rgb_table() if rgb else rgl_table()) if table is None else table
    entries = {e.file: e for e in select(names, known, anisotropic)}
    host = _require_url(base_url)
    folder = Path(to)
    require_outside_libraries(folder, into=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FetchError(f"{folder}: {error.strerror}; choose another folder") from error
    pooch, requests = require("pooch"), require("requests")
    pooch.get_logger().setLevel("ERROR")
    files = pooch.create(
        path=folder,
        base_url=base_url,
        registry={file: e.sha256 and f"sha256:{e.sha256}" for file, e in entries.items()},
        urls={file: f"{base_url.rstrip('/')}/{quote(e.name)}/{quote(e.file)}" for file, e in entries.items()},
        retry_if_failed=attempts - 1,
    )
    downloaded: list[Path] = []
    present: list[Path] = []
    failed: dict[str, str] = {}

    def note(path: str, action: str, _: object) -> str:
        (present if action == "fetch" else downloaded).append(Path(path))
        return path

    meter = _Meter(list(entries.values()))
    downloader = pooch.HTTPDownloader(
        progressbar=meter,
        chunk_size=_BLOCK_BYTES,
        timeout=timeout_s,
        headers={"User-Agent": f"brdf-manifold/{__version__}"},
    )
    is_reachable = True
    for file, entry in entries.items():
        if not is_reachable and not (folder / file).exists():
            failed[entry.name] = "not tried"
            continue
        meter.begin(entry)
        try:
            if entry.sha256 is None:
                _remove_damaged(folder / file)
            files.fetch(file, processor=note, downloader=downloader)
            if entry.sha256 is None:
                read_bsdf(folder / file)
        except FileFormatError as error:
            (folder / file).unlink()
            failed[entry.name] = f"no checksum known, and the content is not a valid file: {error}"
        except (OSError, ValueError) as error:
            is_refused = isinstance(error, requests.ConnectionError) and hasattr(error.args[0], "reason")
            reason = (
                f"no network (host {host} cannot be reached)" if is_refused else " ".join(str(error).split())
            )
            failed[entry.name] = reason
            is_reachable &= bool(downloaded) or not isinstance(error, requests.ConnectionError)
        meter.end()
    there = [path for path in (*downloaded, *present) if entries[path.name].name not in failed]
    unchecked = tuple(e.name for file, e in entries.items() if e.sha256 is None and folder / file in there)
    result = FetchResult(
        tuple(p for p in downloaded if p in there), tuple(p for p in present if p in there), unchecked
    )
    if failed:
        reasons = [f"{file}: {failed[entry.name]}" for file, entry in entries.items() if entry.name in failed]
        raise IncompleteFetchError(_summary(len(entries), result, reasons, folder), result, failed)
    return result


def _remove_damaged(path: Path) -> None:
    """Remove a file whose checksum is not known and whose structure is damaged."""
    try:
        if path.exists():
            read_bsdf(path)
    except FileFormatError:
        path.unlink()


def _require_url(url: str) -> str:
    """Return the host of a plain web address. Raises UsageError for another text."""
    try:
        parts = urlsplit(url)
    except ValueError:
        parts = urlsplit("")
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
        raise UsageError(f"{url}: not the web address of a folder; expected http://... or https://...")
    return parts.hostname


class _Meter:
    """Counts the bytes of all files for pooch, which takes it for a progress bar of one file."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._sizes = {entry.name: entry.size_bytes or 0 for entry in entries}
        self._before, self._done, self._total = 0, 0, 0

    def begin(self, entry: Entry) -> None:
        self._entry = entry

    def end(self) -> None:
        self._before += self._sizes[self._entry.name]

    @property
    def total(self) -> int:
        """Size of the file that the server states; pooch sets it when an attempt begins."""
        return self._total

    @total.setter
    def total(self, size: int) -> None:
        self._done, self._total = 0, size

    def reset(self) -> None:
        """Start again at 0; pooch then adds the whole size."""
        self._done = 0

    def update(self, count: int) -> None:
        """Add bytes. Raises FetchError if there are more than expected."""
        self._done += count
        most = self._entry.size_bytes or _MOST_BYTES
        if self._done > most + _BLOCK_BYTES:
            raise FetchError(f"the server sends more than the expected {most} bytes")
        done = min(self._done, self._total or self._done)  # pooch counts whole blocks
        self._sizes[self._entry.name] = max(self._sizes[self._entry.name], done)
        progress.report(self._before + done, sum(self._sizes.values()), self._entry.file)

    def close(self) -> None:
        """Do nothing, because the next file follows."""


def _summary(count: int, result: FetchResult, reasons: list[str], folder: Path) -> str:
    if count == 1:
        return reasons[0]
    done = len(result.downloaded) + len(result.present)
    return (
        f"{len(reasons)} of {count} files failed ({first_few(reasons, 3, '; ')}); {done} are in {folder}: "
        "run again for the others"
    )
