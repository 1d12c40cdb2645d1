"""Options of commands whose work several processes share, and what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from manifold.errors import UsageError

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from contextlib import AbstractContextManager


def _workers_option(by_default: str) -> Any:
    """The option `--workers`, to stand in an annotation."""
    return typer.Option(
        "--workers",
        "-j",
        help=f"Local processes that share the work. [default: {by_default}]",
        metavar="N",
        min=1,
    )


SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        help="Let the workers of this Dask scheduler share the work, such as tcp://10.0.0.1:8786.",
        metavar="ADDRESS",
    ),
]


@dataclass(frozen=True)
class WorkerOptions:
    """Who shares the work of a command: by default a process per core."""

    workers: Annotated[int | None, _workers_option("one per core, for several materials")] = None
    scheduler: SchedulerOption = None
    default: ClassVar[int | None] = None

    def executor(self) -> AbstractContextManager[Executor | None]:
        """What `work.run` takes, to enter."""
        from manifold import work

        if self.scheduler is None:
            return work.processes(self.workers or self.default)
        if self.workers is not None:
            raise UsageError(
                f"found --workers {self.workers} and --scheduler {self.scheduler}, expected one of them"
            )
        from manifold import cluster

        return cluster.workers(self.scheduler)


@dataclass(frozen=True)
class OneWorkerOptions(WorkerOptions):
    """By default this process alone."""

    workers: Annotated[int | None, _workers_option("1")] = None
    default: ClassVar[int | None] = 1


@dataclass(frozen=True)
class ThreadOptions(OneWorkerOptions):
    """By default threads of this process."""

    workers: Annotated[int | None, _workers_option("threads of this process")] = None


PER_CORE, ONE, THREADS = WorkerOptions(), OneWorkerOptions(), ThreadOptions()
"""What is given where nothing is."""
