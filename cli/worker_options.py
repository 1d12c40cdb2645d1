"""Options of commands whose work several processes share, and what they mean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from manifold.errors import UsageError

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from contextlib import AbstractContextManager


def workers_option(by_default: str) -> Any:
    """The option `--workers`, to stand in an annotation."""
    return typer.Option(
        "--workers",
        "-j",
        help=f"Local processes that share the work. [default: {by_default}]",
        metavar="N",
        min=1,
    )


WorkersOption = Annotated[int | None, workers_option("one per core, for several materials")]
OneWorkerOption = Annotated[int | None, workers_option("1")]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        help="Let the workers of this Dask scheduler share the work, such as tcp://10.0.0.1:8786.",
        metavar="ADDRESS",
    ),
]


def workers_of(
    count: int | None, scheduler: str | None, default: int | None = None
) -> AbstractContextManager[Executor | None]:
    """The workers of `--workers` or `--scheduler`, to enter; by default a process per core, or so many."""
    from manifold import work

    if scheduler is None:
        return work.processes(count or default)
    if count is not None:
        raise UsageError(f"found --workers {count} and --scheduler {scheduler}, expected one of them")
    from manifold import cluster

    return cluster.workers(scheduler)
