"""Download files of the RGL material database; see `manifold.library.downloading` for one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from manifold.errors import FetchError, UsageError
from manifold.library.downloading import Downloader, FatalFetchError, disk, verify
from manifold.library.location import require_outside_libraries
from manifold.library.rgl_table import Entry, rgl_table, select
from manifold.records import Progress

BASE_URL = "https://d38rqfq1h7iukm.cloudfront.net/media/materials"


@dataclass(frozen=True)
class FetchResult:
    """The files of a fetch.

    Attributes:
        downloaded: paths of files that were downloaded.
        present: paths of files that were there already.
        without_checksum: names among both that were checked for structure only: no checksum is known.
    """

    downloaded: tuple[Path, ...]
    present: tuple[Path, ...]
    without_checksum: tuple[str, ...]


class IncompleteFetchError(FetchError):
    """Some files could not be fetched.

    Attributes:
        result: what worked.
        failed: why not, by material name.
    """

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
    table: Mapping[str, Entry] | None = None,
    on_progress: Progress | None = None,
    timeout_s: float = 30.0,
    attempts: int = 4,
    pause_s: float = 1.0,
    deadline_s: float = 3600.0,
) -> FetchResult:
    """Download `BASE/NAME/NAME_spec.bsdf` for each name into a folder.

    A download goes to `NAME_spec.bsdf.part`, which a later call resumes, and gets its final name only when
    its size and SHA-256 are right. A file that is there already is hashed: the right one is left alone, any
    other one is replaced by the verified download. One bad file does not stop the others.

    Args:
        names: materials, or None for all isotropic ones.
        to: the folder; made if need be.
        base_url: http or https.
        anisotropic: with `names` None, also the anisotropic ones (1.2 GB more, no checksums known).
        table: what is known of each file; the database's own table by default.
        on_progress: see `Progress`.
        timeout_s: seconds without data after which a connection counts as stalled.
        attempts: tries per file without a new byte before it is given up.
        pause_s: seconds before the second try; doubles each time.
        deadline_s: seconds for one file, after which it is given up; a later call goes on.
    Raises:
        UsageError: an unknown name, another kind of URL, or a folder in a library.
        FetchError: the folder cannot be written.
        IncompleteFetchError: files are missing; its `result` tells what worked.
    """
    entries = select(names, rgl_table() if table is None else table, anisotropic)
    _require_url(base_url)
    folder = Path(to)
    require_outside_libraries(folder, into=True)
    with disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
    meter = _Meter(entries, on_progress)
    downloader = Downloader(base_url.rstrip("/"), folder, meter.set, timeout_s, attempts, pause_s, deadline_s)
    downloaded, present = [], []
    failed: dict[str, str] = {}
    for entry in entries:
        target = folder / f"{entry.name}_spec.bsdf"
        try:
            if _is_complete(target, entry):
                meter.set(entry.name, target.stat().st_size)
                present.append(target)
            else:
                downloader.fetch(entry, target)
                downloaded.append(target)
        except FatalFetchError as error:
            failed[entry.name] = _one_line(error)
            break
        except FetchError as error:
            failed[entry.name] = _one_line(error)
    kept = {path.name for path in (*downloaded, *present)}
    unchecked = tuple(e.name for e in entries if e.sha256 is None and f"{e.name}_spec.bsdf" in kept)
    result = FetchResult(tuple(downloaded), tuple(present), unchecked)
    if failed:
        raise IncompleteFetchError(_summary(len(entries), result, failed, folder), result, failed)
    return result


def _require_url(url: str) -> None:
    """Raise UsageError for what is no plain web address; one with a password is not repeated."""
    try:
        parts = urlsplit(url)
        is_address = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        is_address, parts = False, None
    if "@" in (url if parts is None else parts.netloc):
        raise UsageError("the base URL holds a user name; expected http://... or https://... without one")
    if not is_address or not url.isascii() or not url.isprintable() or " " in url:
        raise UsageError(f"{url}: not a web address; expected http://... or https://...")
    if parts is not None and (parts.query or parts.fragment):
        raise UsageError(f"{url}: a web address with a query; expected that of a folder")


class _Meter:
    """Adds up the bytes of all files."""

    def __init__(self, entries: Sequence[Entry], on_progress: Progress | None) -> None:
        self._done = {entry.name: 0 for entry in entries}
        self._size = {entry.name: entry.size_bytes or 0 for entry in entries}
        self._on_progress = on_progress

    def set(self, name: str, done: int, size: int | None = None) -> None:
        self._done[name] = done
        self._size[name] = max(size or 0, self._size[name], done)
        if self._on_progress:
            self._on_progress(sum(self._done.values()), sum(self._size.values()), f"{name}_spec.bsdf")


def _is_complete(target: Path, entry: Entry) -> bool:
    if not target.is_file():
        return False
    try:
        verify(target, entry)
    except FetchError:
        return False
    return True


def _one_line(error: FetchError) -> str:
    """An error in one line; the message of a server may have several."""
    return " ".join(str(error).split())


def _summary(count: int, result: FetchResult, failed: dict[str, str], folder: Path) -> str:
    shown = [f"{name}_spec.bsdf: {reason}" for name, reason in list(failed.items())[:3]]
    if len(failed) > 3:
        shown.append(f"and {len(failed) - 3} more")
    if count == 1:
        return shown[0]
    done = len(result.downloaded) + len(result.present)
    untried = count - done - len(failed)
    tail = f", {untried} not tried" if untried else ""
    return (
        f"{len(failed)} of {count} files failed{tail} ({'; '.join(shown)}); the other {done} are in {folder}"
    )
