"""Files of other people, read without waiting and without end."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from manifold.errors import UsageError
from manifold.system.small_files import read_text


def test_a_text_is_read_with_or_without_a_mark_of_utf8(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfgr\xc3\xbcn")
    assert read_text(tmp_path / "a", advice="") == "grün"


def test_what_is_no_small_text_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with (tmp_path / "sparse").open("wb") as stream:
        stream.truncate(100 << 30)
    for path in (*tmp_path.iterdir(), Path("/dev/zero"), tmp_path, tmp_path / "absent", Path("a\0b")):
        with pytest.raises(UsageError, match=r"(no such file|cannot be read).*advice$"):
            read_text(path, advice="advice")
