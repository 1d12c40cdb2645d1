"""Download of one file over HTTP: resumable, verified, and atomic."""

from __future__ import annotations

import hashlib
import http.client
import io
import os
import re
import stat
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from email.message import Message
from pathlib import Path
from urllib.parse import quote

from manifold import __version__
from manifold.errors import FetchError, ManifoldError
from manifold.io_rgl import read_bsdf
from manifold.library.deadline import opener, time_limit
from manifold.library.rgl_table import Entry

BLOCK_BYTES = 1 << 18
MAX_BYTES = 1 << 30  # For files whose size no table knows; the largest in the database have 111 MB.
MIN_BYTES_PER_TIMEOUT = 4096  # A server that drips slower than this per `timeout_s` counts as stalled.


class FatalFetchError(FetchError):
    """A failure that affects all further files: no server, no disk space."""


class _Transient(Exception):
    """A failure that may be gone at the next try."""


class _Stale(Exception):
    """The `.part` file cannot be continued; the download starts again."""


@dataclass
class Downloader:
    """Downloads files of a server into a folder.

    Attributes:
        base_url: without a slash at the end.
        folder: where files go; for errors of the disk.
        on_bytes: told the material, the bytes that are there, and the size of the file if it is known.
        timeout_s, attempts, pause_s, deadline_s: as in `manifold.library.fetch.fetch`.
    """

    base_url: str
    folder: Path
    on_bytes: Callable[[str, int, int | None], None]
    timeout_s: float
    attempts: int
    pause_s: float
    deadline_s: float

    def fetch(self, entry: Entry, target: Path) -> None:
        """Download one file, verify it, and give it its final name.

        Raises:
            FetchError: it cannot be had, or is not what the table says; a FatalFetchError where no other can be had.
        """
        part = target.with_name(target.name + ".part")
        if os.path.lexists(part) and not (part.is_file() and not part.is_symlink()):
            with disk(self.folder):
                part.unlink()  # a link, which would lead elsewhere, or a pipe
        is_right = False
        while not is_right:
            resumed = self._complete(entry, part)
            try:
                verify(part, entry)
                is_right = True
            except FetchError:
                with disk(self.folder):
                    part.unlink()
                # The bytes of an earlier, interrupted download may be at fault: once more from the start.
                if not resumed:
                    raise
        with disk(self.folder):
            os.replace(part, target)

    def _complete(self, entry: Entry, part: Path) -> bool:
        """Fill the `.part`, over as many connections as it takes; whether an older one was continued."""
        resumed = _size(part) > 0
        tries, best = 0, _size(part)
        deadline = time.monotonic() + self.deadline_s
        while True:
            try:
                self._once(entry, part, deadline)
                return resumed
            except _Stale:
                with disk(self.folder):
                    part.unlink(missing_ok=True)
                resumed, problem, unreachable = False, "the server cannot continue the download", False
            except urllib.error.HTTPError as error:
                problem, unreachable = f"the server answers {error.code} {error.reason}", False
                if error.code < 500 and error.code not in (408, 429):
                    raise FetchError(f"{problem} for {error.url}; check the name and the base URL") from error
            except urllib.error.URLError as error:
                problem, unreachable = f"cannot reach {self.base_url} ({error.reason})", True
            except (
                _Transient,
                OSError,
                http.client.HTTPException,
                ValueError,
            ) as error:  # also odd redirections
                problem, unreachable = _describe(error, self.timeout_s), False
            size = _size(part)
            tries, best = (1, size) if size > best else (tries + 1, best)
            is_late = time.monotonic() > deadline
            if tries >= self.attempts or is_late:
                kept = f"; {size} bytes are kept: run again to continue" if size else "; run again later"
                kind = FatalFetchError if unreachable else FetchError
                gave_up = (
                    f"not done after {self.deadline_s:g} s"
                    if is_late
                    else f"{tries} times without a new byte"
                )
                raise kind(f"{problem}, {gave_up}{kept}")
            time.sleep(self.pause_s * 2 ** (tries - 1))

    def _once(self, entry: Entry, part: Path, deadline: float) -> None:
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
            remaining = deadline - time.monotonic()
            with time_limit(min(self.timeout_s, remaining)) as sockets:  # also headers that drip
                response = opener().open(urllib.request.Request(url, headers=headers), timeout=self.timeout_s)
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
            with disk(self.folder):
                flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | (0 if start else os.O_TRUNC)
                stream = io.FileIO(os.open(part, flags, 0o666), "r+")
            with stream, time_limit(deadline - time.monotonic(), sockets):
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
            with disk(self.folder):
                _write_all(stream, block)
            self.on_bytes(entry.name, done, expected)
            if time.monotonic() - mark_s > self.timeout_s:
                if done - mark < MIN_BYTES_PER_TIMEOUT:
                    raise TimeoutError
                mark_s, mark = time.monotonic(), done
        with disk(self.folder):
            os.fsync(stream.fileno())
        if expected is not None and done < expected:
            raise _Transient(f"the connection ended after {done} of {expected} bytes")


def verify(path: Path, entry: Entry) -> None:
    """Raise FetchError unless a file is the one that the table describes."""
    size = _size(path)
    if entry.size_bytes is not None and size != entry.size_bytes:
        raise FetchError(f"has {size} bytes, expected {entry.size_bytes}")
    if entry.sha256 is None:
        try:
            read_bsdf(path)
        except ManifoldError as error:
            raise FetchError(f"no checksum known, and the content is not a valid file: {error}") from error
        return
    with disk(path.parent), path.open("rb") as stream:
        found = hashlib.file_digest(stream, "sha256").hexdigest()
    if found != entry.sha256:
        raise FetchError(
            f"what arrived has SHA-256 {found[:12]}..., expected {entry.sha256[:12]}...; it was deleted: "
            "try again, or another base URL"
        )


def _extent(response: http.client.HTTPResponse, have: int) -> tuple[int, int | None]:
    """Offset of the response in the file, and the file's size, None where the server does not state it."""
    if response.status == 206:
        match = re.fullmatch(
            r"bytes (\d{1,18})-\d{1,18}/(\d{1,18}|\*)", response.headers.get("Content-Range", "").strip()
        )
        if not match or int(match[1]) != have:
            raise _Stale
        return have, None if match[2] == "*" else int(match[2])
    length = response.headers.get("Content-Length", "")  # Range ignored: the whole file comes.
    return 0, int(length) if re.fullmatch(r"\d{1,18}", length) else None


def _announced_total(headers: Message) -> int | None:
    match = re.fullmatch(r"bytes \*/(\d{1,18})", headers.get("Content-Range", "").strip())
    return int(match[1]) if match else None


@contextmanager
def disk(folder: Path) -> Iterator[None]:
    """Tell errors of the disk from those of the network, which are OSErrors too."""
    try:
        yield
    except OSError as error:
        raise FatalFetchError(f"{folder}: {error.strerror}; make room, or choose another folder") from error


def _write_all(stream: io.FileIO, block: bytes) -> None:
    """Unbuffered, so that a full disk is noticed here and not when the stream is closed."""
    rest = memoryview(block)
    while rest:
        rest = rest[stream.write(rest) :]


def _size(path: Path) -> int:
    """Of a file; 0 where there is none, or something else."""
    try:
        status = path.lstat()
    except OSError:
        return 0
    return status.st_size if stat.S_ISREG(status.st_mode) else 0


def _describe(error: Exception, timeout_s: float) -> str:
    if isinstance(error, TimeoutError):
        return f"the server stalled for {timeout_s:g} s"
    if isinstance(error, _Transient):
        return str(error)
    return f"the connection broke ({error or type(error).__name__})"
