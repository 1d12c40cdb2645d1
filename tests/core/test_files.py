"""Files that are written whole, read within bounds, and kept in the user's cache folder."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import platformdirs
import pytest

from manifold.colour.colour_science import cached
from manifold.colour.picture_files import read_picture
from manifold.core import disk, errors
from manifold.core.disk import read_text
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.names import first_few, printable
from manifold.formats.registry import identify
from manifold.library.identity import file_sha256
from manifold.library.store import Library


def test_a_link_is_followed_and_permissions_are_kept(tmp_path):
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "target", tmp_path / "link"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    disk.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    def fail() -> None:
        with disk.replacing(tmp_path / "out") as partial:
            partial.write_text("half")
            raise ZeroDivisionError

    (tmp_path / "out").write_text("old")
    with pytest.raises(ZeroDivisionError):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out").read_text() == "old"


KILLED = """
import os, signal, sys
from pathlib import Path
from manifold.core import disk
with disk.replacing(Path(sys.argv[1])) as partial:
    partial.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_leaves_the_old_file(tmp_path):
    (tmp_path / "out").write_text("old")
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "out")], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert (tmp_path / "out").read_text() == "old"


def test_what_cannot_be_written_is_refused(tmp_path):
    for bad in (tmp_path, tmp_path / "absent" / "x", Path("/dev/null"), tmp_path / ("n" * 300)):
        with pytest.raises(UsageError, match="cannot write this file"):
            disk.write_text(bad, "text")


def test_a_text_is_read_with_or_without_a_mark_of_utf8(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfgr\xc3\xbcn")
    assert read_text(tmp_path / "a", advice="") == "grün"


def test_pipes_binaries_and_huge_files_are_refused_as_texts(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with (tmp_path / "sparse").open("wb") as stream:
        stream.truncate(100 << 30)
    for path in (*tmp_path.iterdir(), Path("/dev/zero"), tmp_path):
        with pytest.raises(UsageError, match=r"advice$"):
            read_text(path, advice="advice")
    with pytest.raises(FileNotFoundError, match=r"no such file; advice$"):
        read_text(tmp_path / "absent", advice="advice")


@pytest.mark.parametrize("damage", [None, b"", b"\xff", b'{"key": "2", "values": 3}'])
def test_values_are_computed_once_per_key_and_again_where_the_file_is_damaged(tmp_path, monkeypatch, damage):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    calls = []

    def compute():
        calls.append(1)
        return {"a": [0.1, 1e-300]}

    for _ in range(2):
        assert cached("x.json", "1", compute) == {"a": [0.1, 1e-300]}
    assert len(calls) == 1
    if damage is not None:
        (platformdirs.user_cache_path("manifold") / "x.json").write_bytes(damage)
        assert cached("x.json", "1", compute) == {"a": [0.1, 1e-300]}
        assert len(calls) == 2


def test_errors_derive_from_the_builtin_errors_in_their_table():
    lines = [line.split("|") for line in (errors.__doc__ or "").splitlines() if line.startswith("| `")]
    table = {cells[1].strip(" `"): [name.strip(" `") for name in cells[2].split(",")] for cells in lines}
    classes = {name: kind for name, kind in vars(errors).items() if isinstance(kind, type)}
    assert set(table) == set(classes) - {"ManifoldError"}
    known = vars(__builtins__) if not isinstance(__builtins__, dict) else __builtins__
    for name, bases in table.items():
        error = classes[name]("x.bsdf: what was found; what to do")
        assert isinstance(error, ManifoldError)
        assert str(error) == "x.bsdf: what was found; what to do"
        assert all(isinstance(error, classes.get(base) or known[base]) for base in bases), name


def test_names_are_shown_on_one_line_and_lists_are_cut():
    assert printable("a\nb\x1b") == "a\\nb\\x1b"
    assert printable("x" * 9, 8) == "xxxxx..."
    assert first_few("abc", 3) == "a, b, c"
    assert first_few("abcde", 3) == "a, b, c and 2 more"


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "x"
    os.mkfifo(pipe)
    for read in (file_sha256, read_picture, identify, Library):
        with pytest.raises(ManifoldError, match=r"not a regular file|a file, expected a library"):
            read(pipe)
