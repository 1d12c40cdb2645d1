"""Job queue of a served page: one command at a time, each in its own process, cancellable."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from manifold.page.actions import Action
from manifold.progress import PROGRESS_VARIABLE

# -P: modules are not imported from the working folder, which holds files from elsewhere.
MANIFOLD = (sys.executable, "-P", "-m", "manifold")
_MOST_OUTPUT = 4000  # characters of a command's output that are passed on


@dataclass(eq=False)
class Job:
    """One command.

    Attributes:
        number: its own.
        action: what it does.
        state: `waiting`, `running`, `done`, `failed` or `cancelled`.
        message: its output, or why it failed.
        result: its JSON, where it prints one.
        share: of the work that is done, where the command reports it.
        stage: what it is at.
        started, ended: on the monotonic clock, in seconds.
    """

    number: int
    action: Action
    state: str = "waiting"
    message: str = ""
    result: dict[str, Any] | None = None
    share: float | None = None
    stage: str = ""
    started: float | None = None
    ended: float | None = None
    process: subprocess.Popen[str] | None = field(default=None, repr=False)

    @property
    def seconds(self) -> float:
        """Seconds that it has run, until now or until it ended."""
        return 0.0 if self.started is None else (self.ended or time.monotonic()) - self.started

    @property
    def has_picture(self) -> bool:
        """Whether it has made a picture that is still there."""
        picture = self.action.picture
        return self.state == "done" and picture is not None and picture.is_file()

    def to_json(self) -> dict[str, Any]:
        """The plain values that the page shows."""
        return {
            "number": self.number, "title": self.action.title, "state": self.state, "message": self.message,
            "result": self.result, "seconds": round(self.seconds, 1),
            "share": self.share, "stage": self.stage, "picture": self.has_picture,
        }  # fmt: skip


class Queue:
    """Runs actions one after the other.

    Attributes:
        jobs: all of them, oldest first.
    """

    def __init__(self, folder: Path, command: tuple[str, ...] = MANIFOLD) -> None:
        """A queue without actions.

        Args:
            folder: working folder of the commands.
            command: what runs `manifold`.
        """
        self.jobs: list[Job] = []
        self._folder, self._command = folder, command
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(1)

    def add(self, action: Action) -> Job:
        """Queue an action."""
        job = Job(len(self.jobs) + 1, action)
        self.jobs.append(job)
        self._worker.submit(self._run, job)
        return job

    def is_writing(self, output: Path) -> bool:
        """Whether a job that is not done will write a file."""
        return any(output in (j.action.output, j.action.picture) and j.ended is None for j in self.jobs)

    def cancel(self, number: int) -> bool:
        """Stop a job, or take it from the queue; whether there was anything to stop."""
        with self._lock:
            job = next((j for j in self.jobs if j.number == number and j.ended is None), None)
            if job is None:
                return False
            job.state = "cancelled"
            if job.process is None:
                job.ended = time.monotonic()
            else:
                with suppress(ProcessLookupError):  # it has just ended
                    os.killpg(job.process.pid, signal.SIGTERM)  # with the processes that it started
            return True

    def close(self) -> None:
        """Cancel everything and wait for the command that runs to end."""
        for job in self.jobs:
            self.cancel(job.number)
        self._worker.shutdown()

    def _run(self, job: Job) -> None:
        read_end, write_end = os.pipe()
        with open(read_end, encoding="utf-8") as progress:
            with self._lock:
                if job.state != "cancelled":
                    job.state, job.started = "running", time.monotonic()
                    job.process = subprocess.Popen(
                        [*self._command, *job.action.arguments], cwd=self._folder, stdin=subprocess.DEVNULL,
                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8",
                        start_new_session=True, pass_fds=[write_end],
                        env=os.environ | {PROGRESS_VARIABLE: str(write_end)},
                    )  # fmt: skip
            os.close(write_end)
            if job.process is not None:
                follower = threading.Thread(target=_follow, args=(job, progress), daemon=True)
                follower.start()
                self._finish(job, *job.process.communicate())
                follower.join()
        if job.action.inputs is not None:
            shutil.rmtree(job.action.inputs)

    def _finish(self, job: Job, stdout: str, stderr: str) -> None:
        assert job.process is not None
        with self._lock:
            job.ended = time.monotonic()
            if job.state == "cancelled":
                return
            job.state = "done" if job.process.returncode == 0 else "failed"
            job.message = (stdout if job.state == "done" else stderr).strip()[-_MOST_OUTPUT:]
            if "--json=-" in job.action.arguments and job.state == "done":
                with suppress(ValueError):
                    job.result, job.message = json.loads(stdout), stderr.strip()[-_MOST_OUTPUT:]


def _follow(job: Job, lines: Iterable[str]) -> None:
    """Keep what a command reports of its progress, until it ends."""
    for line in lines:
        done, total, job.stage = json.loads(line)
        job.share = done / max(total, 1)
