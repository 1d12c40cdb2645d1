"""The job queue of a served page, which runs one command at a time in a worker process; jobs can be cancelled."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, cast

from manifold.page.commands import Call
from manifold.page.worker import INPUTS

# -P: modules are not imported from the working folder, which holds files from elsewhere.
WORKER = (sys.executable, "-P", "-W", "ignore", "-m", "manifold.page.worker")


@dataclass(eq=False)
class Job:
    """One call of a command.

    Attributes:
        state: `waiting`, `running`, `done`, `failed` or `cancelled`.
        share: share of the work that is done, if the command reports it.
        started, ended: times on the monotonic clock, in seconds.
    """

    number: int
    call: Call
    state: str = "waiting"
    message: str = ""
    result: dict[str, Any] | None = None
    share: float | None = None
    stage: str = ""
    started: float | None = None
    ended: float | None = None

    @property
    def seconds(self) -> float:
        """Seconds that it has run, until now or until it ended."""
        return 0.0 if self.started is None else (self.ended or time.monotonic()) - self.started

    @property
    def has_picture(self) -> bool:
        """Return whether it has made a picture that still exists."""
        picture = self.call.picture
        return self.state == "done" and picture is not None and picture.is_file()

    def to_json(self) -> dict[str, Any]:
        """Return the plain values that the page shows."""
        return {
            "number": self.number, "command": self.call.command, "subject": self.call.subject,
            "state": self.state, "message": self.message, "result": self.result, "picture": self.has_picture,
            "seconds": round(self.seconds, 1), "share": self.share, "stage": self.stage,
        }  # fmt: skip


class Queue:
    """Runs calls one after the other; `inputs` is the temporary folder of the files that they read."""

    def __init__(self, command: tuple[str, ...] = WORKER) -> None:
        """Start a queue without calls and its worker, `worker.serve`, whose imports take seconds."""
        self.jobs: list[Job] = []
        self._temporary = TemporaryDirectory(prefix="manifold-explore-")
        self.inputs = Path(self._temporary.name)
        self._command = command
        self._lock = threading.Lock()
        self._thread = ThreadPoolExecutor(1)
        self._worker = self._start()

    def add(self, call: Call) -> Job:
        """Queue a call."""
        job = Job(len(self.jobs) + 1, call)
        self.jobs.append(job)
        self._thread.submit(self._run, job)
        return job

    def is_writing(self, output: Path) -> bool:
        """Return whether an unfinished job will write a file."""
        return any(output in (j.call.output, j.call.picture) and j.ended is None for j in self.jobs)

    def cancel(self, number: int) -> bool:
        """Stop a job, or remove it from the queue; return whether it was running or waiting."""
        with self._lock:
            job = next((j for j in self.jobs if j.number == number and j.ended is None), None)
            if job is None:
                return False
            if job.state == "running":
                self._kill()
            else:
                job.ended = time.monotonic()
            job.state = "cancelled"
            return True

    def close(self) -> None:
        """Cancel everything, end the worker, and remove the files that were sent."""
        for job in self.jobs:
            self.cancel(job.number)
        self._thread.shutdown()
        self._kill()
        _close_pipes(self._worker)
        self._temporary.cleanup()

    def _start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            self._command, cwd=self.inputs, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            start_new_session=True,
            env=os.environ | {"TMPDIR": str(self.inputs), INPUTS: str(self.inputs)},
        )  # fmt: skip

    def _kill(self) -> None:
        """Kill the worker, with the processes that it started; files are written by renaming."""
        with suppress(ProcessLookupError):
            os.killpg(self._worker.pid, signal.SIGKILL)
        self._worker.wait()

    def _run(self, job: Job) -> None:
        with self._lock:
            if job.state != "cancelled":
                if self._worker.poll() is not None:
                    _close_pipes(self._worker)
                    self._worker = self._start()
                job.state, job.started = "running", time.monotonic()
        if job.state == "running":
            reply = self._reply(job)
            with self._lock:
                job.ended = time.monotonic()
                if job.state == "running":
                    job.result, job.message = reply.get("result"), reply.get("failure", "")
                    job.state = "failed" if job.message else "done"
        if job.call.inputs is not None:
            shutil.rmtree(job.call.inputs)

    def _reply(self, job: Job) -> dict[str, Any]:
        """Have the worker run a job, record its progress, and return its result or failure."""
        sends, replies = cast(IO[bytes], self._worker.stdin), cast(IO[bytes], self._worker.stdout)
        with suppress(OSError, ValueError):  # the worker ended, as it wrote or before
            pickle.dump((job.call.command, job.call.arguments), sends)
            sends.flush()
            for line in replies:
                reply = json.loads(line)
                if isinstance(reply, dict):
                    return reply
                done, total, job.stage = reply
                job.share = done / max(total, 1)
        self._kill()
        return {
            "failure": f"the worker process ended (status {self._worker.returncode}; out of memory?); "
            "close other programs, and request it again"
        }


def _close_pipes(worker: subprocess.Popen[bytes]) -> None:
    for pipe in (worker.stdin, worker.stdout):
        with suppress(OSError):  # of what it did not read
            cast(IO[bytes], pipe).close()
