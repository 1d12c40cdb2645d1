"""Download files of the RGL material database: resumed, verified, and never half under the final name.

Source of the files: Dupuy & Jakob 2018, An Adaptive Parameterization for Efficient Material Acquisition and
Rendering, DOI 10.1145/3272127.3275059 (CC0 1.0). Sizes and checksums: `manifold/library/rgl_isotropic.tsv`.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import http.client
import io
import os
import re
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from email.message import Message
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote, urlsplit

from manifold import __version__
from manifold.errors import FetchError, ManifoldError, UsageError
from manifold.io_rgl import read_bsdf
from manifold.records import Progress

BASE_URL = "https://d38rqfq1h7iukm.cloudfront.net/media/materials"
BLOCK_BYTES = 1 << 18
MAX_BYTES = 1 << 30  # For files whose size no table knows; the largest in the database have 111 MB.
MIN_BYTES_PER_TIMEOUT = 4096  # A server that drips slower than this per `timeout_s` counts as stalled.


@dataclass(frozen=True)
class Entry:
    """What the database's table knows of a file.

    Attributes:
        name: of the material.
        size_bytes: of the file, or None.
        sha256: of the file in hexadecimal, or None.
        is_isotropic: whether one incident azimuth was measured.
    """

    name: str
    size_bytes: int | None
    sha256: str | None
    is_isotropic: bool = True


@dataclass(frozen=True)
class FetchResult:
    """What a fetch left in the folder.

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


@cache
def rgl_table() -> Mapping[str, Entry]:
    """The database's spectral files by name: 51 isotropic ones, and 11 anisotropic ones without checksums."""
    data = resources.files("manifold.library")
    with (data / "rgl_isotropic.tsv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines, delimiter="\t"))
    entries = [Entry(row["material"], int(row["size_bytes"]), row["sha256"]) for row in rows]
    names = (data / "rgl_anisotropic.txt").read_text(encoding="utf-8").split()
    entries += [Entry(name, None, None, is_isotropic=False) for name in names]
    return MappingProxyType({entry.name: entry for entry in entries})


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
    Raises:
        UsageError: an unknown name, or another kind of URL.
        FetchError: the folder cannot be written.
        IncompleteFetchError: files are missing; its `result` tells what worked.
    """
    entries = _select(names, rgl_table() if table is None else table, anisotropic)
    if urlsplit(base_url).scheme not in ("http", "https") or not urlsplit(base_url).netloc:
        raise UsageError(f"{base_url}: not a web address; expected http://... or https://...")
    folder = Path(to)
    with _disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
    meter = _Meter(entries, on_progress)
    downloader = _Downloader(base_url.rstrip("/"), folder, meter, timeout_s, attempts, pause_s)
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
        except _Hopeless as error:
            failed[entry.name] = str(error)
            break
        except FetchError as error:
            failed[entry.name] = str(error)
    kept = {path.name for path in (*downloaded, *present)}
    unchecked = tuple(e.name for e in entries if e.sha256 is None and f"{e.name}_spec.bsdf" in kept)
    result = FetchResult(tuple(downloaded), tuple(present), unchecked)
    if failed:
        raise IncompleteFetchError(_summary(len(entries), result, failed, folder), result, failed)
    return result


class _Hopeless(FetchError):
    """A failure that every other file would meet too: no server, no disk space."""


class _Transient(Exception):
    """A failure that may be gone at the next try."""


class _Stale(Exception):
    """What is in the `.part` cannot be continued: begin again."""


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


@dataclass
class _Downloader:
    base_url: str
    folder: Path
    meter: _Meter
    timeout_s: float
    attempts: int
    pause_s: float

    def fetch(self, entry: Entry, target: Path) -> None:
        """Download one file, verify it, and give it its final name."""
        part = target.with_name(target.name + ".part")
        resumed = self._complete(entry, part)
        try:
            _verify(part, entry)
        except FetchError:
            with _disk(self.folder):
                part.unlink()
            if not resumed:
                raise
            # The bytes of an earlier, interrupted download may be at fault: once more from the start.
            self._complete(entry, part)
            try:
                _verify(part, entry)
            except FetchError:
                part.unlink()
                raise
        with _disk(self.folder):
            os.replace(part, target)

    def _complete(self, entry: Entry, part: Path) -> bool:
        """Fill the `.part`, over as many connections as it takes; whether an older one was continued."""
        resumed = _size(part) > 0
        tries, best = 0, _size(part)
        while True:
            try:
                self._once(entry, part)
                return resumed
            except _Stale:
                with _disk(self.folder):
                    part.unlink(missing_ok=True)
                resumed, problem, unreachable = False, "the server cannot continue the download", False
            except urllib.error.HTTPError as error:
                problem, unreachable = f"the server answers {error.code} {error.reason}", False
                if error.code < 500 and error.code not in (408, 429):
                    raise FetchError(f"{problem} for {error.url}; check the name and the base URL") from error
            except urllib.error.URLError as error:
                problem, unreachable = f"cannot reach {self.base_url} ({error.reason})", True
            except (_Transient, OSError, http.client.HTTPException) as error:
                problem, unreachable = _describe(error, self.timeout_s), False
            size = _size(part)
            tries, best = (1, size) if size > best else (tries + 1, best)
            if tries >= self.attempts:
                kept = f"; {size} bytes are kept: run again to continue" if size else "; run again later"
                kind = _Hopeless if unreachable else FetchError
                raise kind(f"{problem}, {tries} times without a new byte{kept}")
            time.sleep(self.pause_s * 2 ** (tries - 1))

    def _once(self, entry: Entry, part: Path) -> None:
        """One connection: from where the `.part` ends to the end of the file."""
        have = _size(part)
        if entry.size_bytes is not None and have == entry.size_bytes:
            return
        if have > (entry.size_bytes or MAX_BYTES):
            raise _Stale
        url = f"{self.base_url}/{quote(entry.name)}/{quote(entry.name)}_spec.bsdf"
        headers = {"User-Agent": f"brdf-manifold/{__version__}", "Accept-Encoding": "identity"}
        if have:
            headers["Range"] = f"bytes={have}-"
        try:
            response = _opener().open(urllib.request.Request(url, headers=headers), timeout=self.timeout_s)
        except urllib.error.HTTPError as error:
            error.close()
            if error.code != 416:
                raise
            if _announced_total(error.headers) == have and entry.size_bytes is None:
                return  # The `.part` was whole already.
            raise _Stale from error
        with response:
            start, total = _extent(response, have)
            expected = entry.size_bytes or total
            if entry.size_bytes is not None and total is not None and total != entry.size_bytes:
                raise FetchError(f"the server's file has {total} bytes, expected {entry.size_bytes}")
            with _disk(self.folder):
                stream = part.open("r+b" if start else "wb", buffering=0)
            with stream:
                self._copy(response, stream, entry, start, expected)

    def _copy(
        self,
        response: http.client.HTTPResponse,
        stream: io.FileIO,
        entry: Entry,
        start: int,
        expected: int | None,
    ) -> None:
        done, limit = start, expected or MAX_BYTES
        stream.seek(start)
        mark_s, mark = time.monotonic(), done
        while block := response.read1(BLOCK_BYTES):
            done += len(block)
            if done > limit:
                raise FetchError(f"the server sends more than the expected {limit} bytes")
            with _disk(self.folder):
                _write_all(stream, block)
            self.meter.set(entry.name, done, expected)
            if time.monotonic() - mark_s > self.timeout_s:
                if done - mark < MIN_BYTES_PER_TIMEOUT:
                    raise TimeoutError
                mark_s, mark = time.monotonic(), done
        with _disk(self.folder):
            os.fsync(stream.fileno())
        if expected is not None and done < expected:
            raise _Transient(f"the connection ended after {done} of {expected} bytes")


def _select(names: Sequence[str] | None, table: Mapping[str, Entry], anisotropic: bool) -> list[Entry]:
    if names is None:
        return [entry for entry in table.values() if entry.is_isotropic or anisotropic]
    for name in names:
        if name not in table:
            near = difflib.get_close_matches(name, table, n=3)
            advice = f"did you mean {' or '.join(near)}?" if near else "leave the name out to fetch all"
            raise UsageError(f"{name}: no such material in the RGL database; {advice}")
    return [table[name] for name in dict.fromkeys(names)]


def _is_complete(target: Path, entry: Entry) -> bool:
    if not target.is_file():
        return False
    try:
        _verify(target, entry)
    except FetchError:
        return False
    return True


def _verify(path: Path, entry: Entry) -> None:
    """Raise FetchError unless a file is the one that the table describes."""
    size = _size(path)
    if entry.size_bytes is not None and size != entry.size_bytes:
        raise FetchError(f"has {size} bytes, expected {entry.size_bytes}")
    if entry.sha256 is None:
        try:
            read_bsdf(path)
        except ManifoldError as error:
            raise FetchError(f"no checksum known, and the content is no valid file: {error}") from error
        return
    with _disk(path.parent), path.open("rb") as stream:
        found = hashlib.file_digest(stream, "sha256").hexdigest()
    if found != entry.sha256:
        raise FetchError(
            f"what arrived has SHA-256 {found[:12]}..., expected {entry.sha256[:12]}...; it was deleted: "
            "try again, or another base URL"
        )


def _extent(response: http.client.HTTPResponse, have: int) -> tuple[int, int | None]:
    """Where in the file the answer begins, and how long the file is, if the server says so."""
    if response.status == 206:
        match = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", "").strip())
        if not match or int(match[1]) != have:
            raise _Stale
        return have, None if match[2] == "*" else int(match[2])
    length = response.headers.get("Content-Length", "")  # Range ignored: the whole file comes.
    return 0, int(length) if length.isdecimal() else None


def _announced_total(headers: Message) -> int | None:
    match = re.fullmatch(r"bytes \*/(\d+)", headers.get("Content-Range", "").strip())
    return int(match[1]) if match else None


@cache
def _opener() -> urllib.request.OpenerDirector:
    """Speaks http and https, through the user's proxies; unlike `urlopen`, no file:, ftp: or data:."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler,
        urllib.request.HTTPHandler,
        urllib.request.HTTPSHandler,
        urllib.request.HTTPRedirectHandler,
        urllib.request.HTTPErrorProcessor,
        urllib.request.HTTPDefaultErrorHandler,
        urllib.request.UnknownHandler,
    ):
        opener.add_handler(handler())
    return opener


@contextmanager
def _disk(folder: Path) -> Iterator[None]:
    """Tell errors of the disk from those of the network, which are OSErrors too."""
    try:
        yield
    except OSError as error:
        raise _Hopeless(f"{folder}: {error.strerror}; make room, or choose another folder") from error


def _write_all(stream: io.FileIO, block: bytes) -> None:
    """Unbuffered, so that a full disk is noticed here and not when the stream is closed."""
    rest = memoryview(block)
    while rest:
        rest = rest[stream.write(rest) :]


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _describe(error: Exception, timeout_s: float) -> str:
    if isinstance(error, TimeoutError):
        return f"the server stalled for {timeout_s:g} s"
    if isinstance(error, _Transient):
        return str(error)
    return f"the connection broke ({error or type(error).__name__})"


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
