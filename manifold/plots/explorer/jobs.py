"""Job queue of a served page: one command at a time, each in its own process, cancellable."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from manifold.errors import UsageError
from manifold.plots.explorer.actions import SPECTRUM, Action
from manifold.system import temporary
from manifold.system.stages import PROGRESS_VARIABLE

MOST_WAITING = 50
_MOST_KEPT = 200  # jobs that are remembered
_MOST_STAGE = 100  # characters of what a command says it is at
_MOST_WORDS = 4000  # characters of a command's output that are passed on
_GRACE_S = 3.0  # between asking a process to end and ending it


@dataclass(eq=False)
class Job:
    """One command.

    Attributes:
        number: its own.
        action: what it does.
        state: `waiting`, `running`, `done`, `failed` or `cancelled`.
        words: its output, or why it failed.
        result: its JSON, where it prints one.
        share: of the work that is done, where the command tells.
        stage: what it is at.
        seconds: it took, or has taken so far.
    """

    number: int
    action: Action
    clean_up: Callable[[], None]
    state: str = "waiting"
    words: str = ""
    result: dict[str, Any] | None = None
    share: float | None = None
    stage: str = ""
    started: float | None = None
    ended: float | None = None
    process: subprocess.Popen[str] | None = field(default=None, repr=False)

    @property
    def seconds(self) -> float:
        """Seconds that it has run, until now or until it ended."""
        if self.started is None:
            return 0.0
        return (self.ended or time.monotonic()) - self.started

    @property
    def has_picture(self) -> bool:
        """Whether it has made a picture that is still there."""
        picture = self.action.picture
        return self.state == "done" and picture is not None and picture.is_file()

    def to_json(self) -> dict[str, Any]:
        """The plain values that the page shows."""
        return {
            "number": self.number, "title": self.action.title, "state": self.state, "words": self.words,
            "result": self.result, "seconds": round(self.seconds, 1),
            "share": self.share, "stage": self.stage, "picture": self.has_picture,
        }  # fmt: skip


class Queue:
    """Runs actions one after the other.

    Args:
        folder: working folder of the commands.
        command: what runs `manifold`.
    """

    def __init__(self, folder: Path, command: tuple[str, ...] = (sys.executable, "-m", "manifold")) -> None:
        self._folder, self._command = folder, command
        self._jobs: dict[int, Job] = {}
        self._waiting: deque[Job] = deque()
        self._numbers = itertools.count(1)
        self._changed = threading.Condition()
        self._is_closed = False
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()

    def add(self, action: Action, clean_up: Callable[[], None] = lambda: None) -> Job:
        """Queue an action.

        Raises:
            UsageError: too many wait already.
        """
        with self._changed:
            if len(self._waiting) >= MOST_WAITING:
                raise UsageError(f"{MOST_WAITING} actions wait already; cancel some, or wait")
            job = Job(next(self._numbers), action, clean_up)
            self._jobs[job.number] = job
            self._waiting.append(job)
            over = [n for n, j in self._jobs.items() if j.ended is not None][: -_MOST_KEPT or None]
            for number in over:
                del self._jobs[number]
            self._changed.notify_all()
        return job

    def is_writing(self, output: Path) -> bool:
        """Whether a job that is not done will write a file."""
        with self._changed:
            return any(
                output in (j.action.output, j.action.picture) and j.ended is None for j in self._jobs.values()
            )

    def jobs(self) -> list[Job]:
        """All that are remembered, oldest first."""
        with self._changed:
            return list(self._jobs.values())

    def cancel(self, number: int) -> bool:
        """Stop a job, or take it from the queue; whether there was anything to stop."""
        with self._changed:
            job = self._jobs.get(number)
            if job is None or job.ended is not None:
                return False
            job.state = "cancelled"
            if job in self._waiting:
                self._waiting.remove(job)
                self._end(job)
            elif job.process is not None:
                _stop(job.process)
            return True

    def close(self) -> None:
        """Cancel everything and wait for the worker."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        for job in self.jobs():
            self.cancel(job.number)
        self._worker.join(2 * _GRACE_S)

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._is_closed:
                    self._changed.wait()
                if self._is_closed:
                    return
                job = self._waiting.popleft()
                job.state, job.started = "running", time.monotonic()
            try:
                with temporary.folder() as folder:
                    self._run(job, folder)
            except OSError as error:
                job.state, job.words = "failed", str(error.strerror or error)
            with self._changed:
                self._end(job)

    def _run(self, job: Job, folder: Path) -> None:
        arguments = list(job.action.arguments)
        if job.action.spectrum is not None:
            path = folder / "reflectance.txt"
            path.write_text(job.action.spectrum, encoding="utf-8")
            arguments[arguments.index(SPECTRUM)] = f"--reflectance={path}"
        read_end, write_end = os.pipe()
        with open(read_end, encoding="utf-8", errors="replace") as lines:
            try:
                with self._changed:
                    if job.state == "cancelled":
                        return
                    job.process = subprocess.Popen(
                        [*self._command, *arguments], cwd=self._folder, stdin=subprocess.DEVNULL,
                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8", errors="replace",
                        start_new_session=True, pass_fds=[write_end],
                        env=os.environ | {PROGRESS_VARIABLE: str(write_end)},
                    )  # fmt: skip
            finally:
                os.close(write_end)
            listener = threading.Thread(target=_listen, args=(job, lines), daemon=True)
            listener.start()
            self._wait(job, arguments)
            listener.join(_GRACE_S)

    def _wait(self, job: Job, arguments: Sequence[str]) -> None:
        assert job.process is not None
        stdout, stderr = job.process.communicate()
        if job.state == "cancelled":
            return
        job.state = "done" if job.process.returncode == 0 else "failed"
        job.words = (stdout if job.state == "done" else stderr).strip()[-_MOST_WORDS:]
        if "--json=-" in arguments and job.state == "done":
            with suppress(ValueError):
                job.result, job.words = json.loads(stdout), stderr.strip()[-_MOST_WORDS:]

    def _end(self, job: Job) -> None:
        job.ended = time.monotonic()
        job.clean_up()


def _listen(job: Job, lines: Iterable[str]) -> None:
    """Keep what a command tells of its progress, until it ends."""
    for line in lines:
        with suppress(ValueError, TypeError):
            done, total, stage = json.loads(line)
            job.share, job.stage = min(max(done / max(total, 1), 0.0), 1.0), str(stage)[:_MOST_STAGE]


def _stop(process: subprocess.Popen[str]) -> None:
    """End a process and what it started: politely, then not."""

    def signalled(number: int) -> None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)

    signalled(signal.SIGTERM)
    timer = threading.Timer(_GRACE_S, lambda: signalled(signal.SIGKILL) if process.poll() is None else None)
    timer.daemon = True
    timer.start()
