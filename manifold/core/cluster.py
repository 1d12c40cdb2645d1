"""Uses the workers of a Dask scheduler, on machines that share a file system.

Tasks are sent as bytes, which only the worker unpickles, so that the scheduler imports little of this package.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import queue
import re
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from manifold.core import shipped
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.extras import require
from manifold.core.names import printable
from manifold.core.threads import VARIABLE

if TYPE_CHECKING:
    from distributed import Client

P = ParamSpec("P")
R = TypeVar("R")

_PACKAGES = ("brdf-manifold", "numpy", "scipy", "mitsuba")  # on which results depend
_CONNECT_S = 8.0
_ADDRESS = re.compile(
    r"inproc://\S+|((tcp|tls|wss?)://)?(\[[0-9A-Fa-f:.]+\]|[\w.-]+):(?P<port>\d{1,5})", re.ASCII
)
_MOST_PORT = 65535
# Of workers with several threads: the folder and the renderer are the process's.
_one_at_a_time = threading.Lock()


@contextmanager
def workers(address: str) -> Iterator[Executor]:
    """Yield the workers of a Dask scheduler, such as `tcp://10.0.0.1:8786`, for `work.run`.

    Workers that join later are used as well, and Dask repeats the tasks of lost workers. Tasks run in the working
    folder of this process, so that relative paths have the same meaning.
    """
    require("distributed")
    from distributed import KilledWorker

    with _connected(address) as client:
        try:
            yield _Workers(client)
        except KilledWorker:
            raise ManifoldError(
                f"{address}: several workers ended during one task (out of memory?); give them more memory, "
                "and run again: finished results are kept"
            ) from None
        except CancelledError:
            raise ManifoldError(
                f"{address}: the scheduler was lost; run again: finished results are kept"
            ) from None
        except RuntimeError as error:
            if "deserialization of the task graph" not in str(error):
                raise
            raise ManifoldError(
                f"{address}: the scheduler lacks this package; start it in the environment of this command"
            ) from error


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # losses are reported in one line here
    parts = _ADDRESS.fullmatch(address)
    if parts is None or not 1 <= int(parts["port"] or 1) <= _MOST_PORT:
        raise UsageError(f"scheduler '{address}', expected an address such as tcp://10.0.0.1:8786")
    found: queue.Queue[Client | Exception] = queue.Queue()

    class Connected(Client):
        """A client that is closed on deletion only if it is connected: otherwise that waits, and prints its failure."""

        def __del__(self) -> None:
            if self.status == "running":
                super().__del__()

    def connect() -> None:
        try:
            found.put(Connected(address, timeout=_CONNECT_S, set_as_default=False))
        except Exception as error:
            found.put(error)

    # In a thread of its own: at a peer that accepts and says nothing, the client waits for ever.
    threading.Thread(target=connect, daemon=True).start()
    try:
        client = found.get(timeout=_CONNECT_S + 1.0)
    except queue.Empty:
        client = TimeoutError(f"no answer within {_CONNECT_S + 1.0:g} s")
    if isinstance(client, Exception):
        raise ManifoldError(
            f"{address}: no Dask scheduler answers ({printable(str(client), 160)}); start one, or check the address"
        ) from client
    with client:
        yield client


class _Workers(Executor):
    """Dask's executor, whose tasks travel pickled, with the folder and the versions of packages here."""

    def __init__(self, client: Client) -> None:
        self._executor = client.get_executor(pure=False)
        self._run = partial(_run, os.getcwd(), versions())

    def submit(self, function: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Submit a call to the scheduler, and return its future."""
        return self._executor.submit(self._run, pickle.dumps(partial(function, *args, **kwargs)))


@lru_cache
def versions() -> dict[str, str]:
    """Return the versions of the installed packages on which results depend."""
    found = {}
    for package in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found | {shipped.BUILT_IN.name: shipped.content_hash()}


def _run(folder: str, expected: dict[str, str], task: bytes) -> Any:
    """Run one task in a worker, in a folder, where packages have the expected versions."""
    from distributed import get_worker

    worker = get_worker()
    for package, known in versions().items():
        if expected.get(package) != known:
            raise ManifoldError(
                f"worker {worker.address}: found {package} {known}, expected {expected.get(package)}; install the same "
                "versions everywhere"
            )
    os.environ.setdefault(VARIABLE, str(worker.state.nthreads))
    with _one_at_a_time:
        try:
            with contextlib.chdir(folder):
                return pickle.loads(task)()
        except OSError as error:  # not of the task, whose failures are results
            raise ManifoldError(
                f"worker {worker.address}: cannot work in {folder} ({error.strerror}); start in a folder that all "
                "machines share"
            ) from error
