"""Temporary folders; those of killed processes are removed by the next run."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from manifold.system.atomic import try_lock

_NAME = re.compile(r"\.manifold-work-[0-9a-f]{16}")


@contextmanager
def folder() -> Iterator[Path]:
    """A new empty folder, removed at the end; locked meanwhile, which tells it from those of killed processes."""
    _sweep(tempfile.gettempdir())
    path, descriptor = _make()
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        os.close(descriptor)


def _make() -> tuple[Path, int]:
    while True:
        path = Path(tempfile.gettempdir(), f".manifold-work-{secrets.token_hex(8)}")
        path.mkdir(mode=0o700)
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try_lock(descriptor)
        with suppress(OSError):
            if os.path.samestat(os.stat(path), os.fstat(descriptor)):
                return path, descriptor
        os.close(descriptor)  # swept between its making and its lock


@cache
def _sweep(base: str) -> None:
    """Remove this user's folders that nobody has locked, the first time that this process makes one."""
    with suppress(OSError):
        for entry in os.scandir(base):
            if not _NAME.fullmatch(entry.name) or not entry.is_dir(follow_symlinks=False):
                continue
            if entry.stat(follow_symlinks=False).st_uid != os.getuid():
                continue
            descriptor = os.open(entry.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                if try_lock(descriptor):
                    shutil.rmtree(entry.path, ignore_errors=True)
            finally:
                os.close(descriptor)
