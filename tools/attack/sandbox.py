"""One case in a process of its own: a fork of this one, with everything imported, less memory and a deadline."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MOST_SECONDS = 10.0  # of a core
MOST_WAITING = 60  # seconds, on machines that have other work too
MOST_BYTES = 2 << 30


@dataclass(frozen=True)
class Ended:
    """How a case ended.

    Attributes:
        status: exit status; negative, the signal that ended it.
        seconds: of a core that it took.
        waited: seconds from its start to its end.
        bytes: of memory at most, beyond what this process held when it forked.
        out, err: what it wrote.
    """

    status: int
    seconds: float
    waited: float
    bytes: int
    out: str
    err: str

    @property
    def problem(self) -> str | None:
        """What no input may cause: a traceback, a crash, a hang, too much memory; None where there was nothing."""
        if self.seconds > MOST_SECONDS or self.status == -signal.SIGALRM:
            return f"hang: {self.seconds:.1f} s of a core, {self.waited:.1f} s in all"
        if self.status < 0:
            return f"crash: {signal.Signals(-self.status).name}"
        if "Traceback" in self.err or "internal error" in self.err:
            return "traceback: " + self.err.strip().splitlines()[-1][:300]
        if self.status not in (0, 1, 2):
            return f"status {self.status}"
        if self.bytes > MOST_BYTES:
            return f"memory: {self.bytes / 1e9:.1f} GB"
        return None


def _memory() -> tuple[int, int]:
    """Bytes of address space and of resident memory that this process has."""
    space, resident, *_ = Path("/proc/self/statm").read_text().split()
    return int(space) * resource.getpagesize(), int(resident) * resource.getpagesize()


def start(task: Callable[[], object], folder: Path, log: Path) -> int:
    """Fork, and do a task in a folder; the process's number."""
    pid = os.fork()
    if pid:
        return pid
    status = 3
    try:
        os.setpgid(0, 0)
        for number, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(log.with_suffix(f".{name}"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.stdout, sys.stderr = open(1, "w"), open(2, "w")  # noqa: SIM115
        os.chdir(folder)
        signal.alarm(MOST_WAITING)  # the default action: it ends the process
        resource.setrlimit(resource.RLIMIT_AS, (_memory()[0] + 2 * MOST_BYTES,) * 2)
        task()
        status = 0
    except SystemExit as leaving:
        status = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(status & 0xFF)


def wait(pid: int, began: float, log: Path) -> Ended:
    """The end of a process that `start` made."""
    _, status, usage = os.wait4(pid, 0)
    texts = [
        log.with_suffix(f".{name}").read_text(errors="replace")
        if log.with_suffix(f".{name}").exists()
        else ""
        for name in ("out", "err")
    ]
    code = os.waitstatus_to_exitcode(status)
    seconds = usage.ru_utime + usage.ru_stime
    grown = (usage.ru_maxrss << 10) - _memory()[1]  # a fork counts its parent's pages as its own
    return Ended(code, seconds, time.monotonic() - began, max(grown, 0), texts[0], texts[1])


def run(task: Callable[[], object], folder: Path, log: Path) -> Ended:
    """Do a task in a fork, and wait for it."""
    began = time.monotonic()
    return wait(start(task, folder, log), began, log)
