"""Files that appear whole, in their place, with nothing left beside them."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from manifold.errors import UsageError
from manifold.system import atomic


def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    atomic.write_text(pipe, "text")
    reader.join(5)
    assert got == [b"text"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert [p.name for p in tmp_path.iterdir()] == ["pipe"]


def test_a_character_device_stays_one():
    atomic.write_text(Path("/dev/null"), "text")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_a_link_is_followed_and_permissions_are_kept(tmp_path):
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "target", tmp_path / "link"
    target.write_text("old")
    target.chmod(0o640)
    link.symlink_to(target)
    atomic.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_a_planted_temporary_file_is_not_written_to(tmp_path):
    # The name of the temporary file was `.PID.NAME`: somebody who knew it could let it lead elsewhere.
    (tmp_path / f".{os.getpid()}.out").symlink_to(tmp_path / "victim")
    atomic.write_text(tmp_path / "out", "text")
    assert not (tmp_path / "victim").exists()
    assert not (tmp_path / "out").is_symlink()


def test_threads_write_one_name_and_readers_see_whole_texts(tmp_path):
    path, problems = tmp_path / "out", []

    def write(letter: str) -> None:
        for _ in range(30):
            try:
                atomic.write_text(path, letter * 9999)
            except Exception as error:
                problems.append(error)

    threads = [threading.Thread(target=write, args=(letter,)) for letter in "abcd"]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if path.exists():
            found = path.read_text()
            assert len(found) == 9999
            assert len(set(found)) == 1
    assert not problems
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


KILLED = """
import os, signal, sys
from pathlib import Path
from manifold.system import atomic
with atomic.replacing(Path(sys.argv[1])) as partial:
    partial.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path):
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "out")])
    assert ended.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    atomic.write_text(tmp_path / "other", "text")
    assert [p.name for p in tmp_path.iterdir()] == ["other"]


def test_the_temporary_file_of_a_running_process_stays(tmp_path):
    with atomic.replacing(tmp_path / "slow") as partial:
        partial.write_text("slow")
        atomic._swept.clear()
        atomic.write_text(tmp_path / "quick", "quick")
    assert (tmp_path / "slow").read_text() == "slow"


def test_what_is_neither_file_nor_stream_is_refused(tmp_path):
    for bad in (tmp_path, tmp_path / "absent" / "x", Path("a\0b"), tmp_path / ("n" * 300)):
        with pytest.raises(UsageError, match="cannot write this file"):
            atomic.write_text(bad, "text")
