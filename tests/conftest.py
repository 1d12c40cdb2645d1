"""Fixtures that many tests share."""

from __future__ import annotations

import gc
import signal
from pathlib import Path

import numpy as np
import pytest

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell starts what runs in its background
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # or programs that tests interrupt would ignore it, too

gc.disable()  # until all tests are collected

SLOW_LEFT = pytest.StashKey[int]()
LONGEST = (
    "lamps", "convert", "surface_files", "bsdf_plugin", "export_command", "sources", "photographs",
    "stability_catalogue", "export_direct", "workflows", "chart", "report", "attributes", "surface", "cli", "budget",
    "readme", "completion", "material", "store", "without_mitsuba", "principled", "explore_visitor", "render",
    "forward_model", "instruments", "derivatives", "model", "turned_samples", "reports", "tutorials", "gloss",
    "notebook", "core_alone", "microfacet", "readings", "explore_server", "compact", "simulator_formats",
    "explore_page", "fit_picture", "fit_json", "measured_plugin", "brdf", "corpus", "built_in_calibrations",
    "selection", "principled_model", "reconstruction", "latents", "explore_surfaces", "workers",
    "compressed_files", "nonnegative_methods", "heldout", "export_files",
)  # fmt: skip
"""Test files that take longest: first, or one process is left with them when the others are done."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that take longest first, otherwise as collected."""
    place = {f"test_{name}.py": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(LONGEST)))


def pytest_collection_finish() -> None:
    """Look for garbage among what tests make alone, and not each time among all imported modules and tests."""
    gc.freeze()
    gc.enable()


def pytest_deselected(items: list[pytest.Item]) -> None:
    """Count the slow tests that are left out; where tests are shared out, in every worker."""
    left = [item for item in items if item.get_closest_marker("slow")]
    if left:
        left[0].config.stash[SLOW_LEFT] = len(left)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Tell the process that shares tests out; let the interpreter free all at its end, or nanobind reports leaks."""
    gc.unfreeze()
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["slow_left"] = session.config.stash.get(SLOW_LEFT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node) -> None:
    """Hear of it from a worker."""
    node.config.stash[SLOW_LEFT] = getattr(node, "workeroutput", {}).get("slow_left", 0)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many slow tests were left out."""
    left = config.stash.get(SLOW_LEFT, 0)
    if left:
        terminalreporter.write_line(f"{left} slow tests left to `make test-slow`")


@pytest.fixture
def rng() -> np.random.Generator:
    """The one source of randomness in tests."""
    return np.random.default_rng(20261121)


@pytest.fixture(scope="session")
def library(tmp_path_factory) -> Path:
    """A library of a few RGB materials, to which tests add nothing but what it caches."""
    from helpers.small_library import small_library

    return small_library(tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="session")
def atoms(library):
    """The atoms of which readings are completed."""
    from manifold.estimate import LibraryAtoms
    from manifold.library.store import Library

    return LibraryAtoms.of_library(Library.open(library))


@pytest.fixture
def quick_pictures(monkeypatch):
    """Balls and figures that are quickly drawn, for tests that do not look at them."""
    from helpers.quick_pictures import draw_quickly

    draw_quickly(monkeypatch)


@pytest.fixture
def run(capsys, monkeypatch):
    """The command in this process, in a given folder: status, stdout, stderr."""
    from manifold.cli import terminal
    from manifold.cli.main import run as run_main
    from manifold.core import work

    # To import the package takes a process seconds: tests of several processes say how many.
    processes = work.processes
    monkeypatch.setattr(work, "processes", lambda count=None: processes(count or 1))

    # Lines that only say that a command lives depend on the speed of the machine.
    monkeypatch.setattr(terminal, "_SILENT_SECONDS", 1e3)

    def call(*arguments, cwd):
        monkeypatch.chdir(cwd)
        with pytest.raises(SystemExit) as caught:
            run_main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return caught.value.code or 0, captured.out, captured.err

    return call


@pytest.fixture(scope="module")
def short_search():
    """A short search for few atoms, for reports and charts that do not look at how good they are."""
    from manifold.model import reconstruction

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reconstruction, "_CANDIDATES", 6)
        patch.setattr(reconstruction, "_SWEEPS", 1)
        yield
