"""Choice of the Mitsuba backend: a working LLVM library, or the scalar variants.

Mitsuba's fast variants compile with a libLLVM that Dr.Jit finds on the machine; `libllvm` finds one that works.
This module (and nothing else) imports Mitsuba and Dr.Jit; others ask `mitsuba()` and `drjit()` for them, and get a
`RendererError` where Mitsuba is missing.

Caveats: Dr.Jit takes its libLLVM when it is imported and never another one in the same process. The variant is one
setting of the whole process, so threads must not render in different ones at a time; objects of one variant mean
nothing in another. Neither survives a fork: use spawned processes.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from manifold.errors import RendererError, UsageError
from manifold.rendering import libllvm
from manifold.rendering.libllvm import INSTALL, LIBRARY_VARIABLE, WORKS, Probe, mitsuba_version
from manifold.system import interrupts

RENDERER_VARIABLE = "MANIFOLD_RENDERER"
"""Environment variable that forces a backend: `llvm`, `scalar`, or `auto` (as if it were not set)."""

_COLOURS = ("spectral", "rgb", "mono")


class RendererWarning(UserWarning):
    """Rendering works, but slowly."""


@dataclass(frozen=True)
class Backend:
    """How Mitsuba runs here.

    Attributes:
        kind: `llvm` (vectorised, compiled) or `scalar`.
        library: the libLLVM of an LLVM backend.
        advice: one line on what to install for faster renders, where there is something to say.
        probes: the libraries that were tried, in that order.
    """

    kind: str
    library: Path | None = None
    advice: str | None = None
    probes: tuple[Probe, ...] = ()

    @property
    def is_llvm(self) -> bool:
        """Whether renders are vectorised."""
        return self.kind == "llvm"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "kind": self.kind,
            "library": None if self.library is None else str(self.library),
            "advice": self.advice,
            "mitsuba": mitsuba_version(),
            "probes": [asdict(probe) | {"library": str(probe.library)} for probe in self.probes],
        }


def is_available() -> bool:
    """Whether Mitsuba can be imported; rendering and fitting need it, and nothing else does."""
    try:
        _import_mitsuba()
    except RendererError:
        return False
    return True


def _import_mitsuba() -> Any:
    """Mitsuba, in whatever variant is set. Raises: as `choose`."""
    choose()
    return sys.modules["mitsuba"]


@cache
def _require_own_plugins_first(mi: Any) -> None:
    """Before the current folder, where `plugins/diffuse.so` would be loaded in place of Mitsuba's own."""
    mi.file_resolver().prepend(str(Path(mi.__file__).parent))


@cache
def own_plugins() -> frozenset[str]:
    """The names of Mitsuba's own plugins. Raises: RendererError, where Mitsuba is missing."""
    folder = Path(_import_mitsuba().__file__).parent / "plugins"
    return frozenset(path.name.partition(".")[0] for path in folder.iterdir())


def is_registered(name: str) -> bool:
    """Whether this process has registered a plugin of that name from Python; no library is loaded to find out."""
    mi = sys.modules.get("mitsuba")
    if mi is None or mi.variant() is None:
        return False
    folders = [folder / "plugins" for folder in (Path(), *search_folders())]
    if any(folder.is_dir() and any(folder.glob(f"{name}.*")) for folder in folders):
        return False
    if mi.PluginManager.instance().plugin_type(name) != mi.ObjectType.Unknown:
        return True
    try:  # the types of plugins from Python are unknown in LLVM variants; no file of this name is there to be loaded
        mi.load_dict({"type": name})
    except Exception as error:
        return f'Plugin "{name}" not found' not in str(error)
    return True


def search_folders() -> list[Path]:
    """The folders in which Mitsuba looks for files: its own, and the current one of its import."""
    return [Path(str(folder)) for folder in _import_mitsuba().file_resolver()]


_chosen: Backend | None = None
_process: int | None = None
_is_advised = False


def choose(*, refresh: bool = False) -> Backend:
    """The backend of this process: the first libLLVM that works, newest first, or the scalar variants.

    Args:
        refresh: try the libraries again, whatever is remembered of them.
    Raises:
        UsageError: `MANIFOLD_RENDERER` is none of its values, or asks for an LLVM that is not there.
        RendererError: Mitsuba is not installed, or does not load on this machine.
    """
    global _chosen
    try:
        if _chosen is None or refresh:
            _chosen = choose_among(libllvm.find_libraries(), libllvm.probe, refresh=refresh)
            if _chosen.library is not None:  # for Dr.Jit, which reads it once, as it is imported
                os.environ[LIBRARY_VARIABLE] = str(_chosen.library)
        import mitsuba
    except ImportError as error:
        if interrupts.is_interruption(error):
            raise KeyboardInterrupt from error
        raise RendererError(
            f"rendering and fitting need Mitsuba, which is missing ({error}); pip install mitsuba, on a platform that "
            "it has a wheel for"
        ) from error
    _require_own_plugins_first(mitsuba)
    return _chosen


def choose_among(
    libraries: Sequence[Path], attempt: Callable[[Path], str], *, refresh: bool = False
) -> Backend:
    """The backend for given libraries; `attempt` tries one and returns `WORKS` or what happened.

    Raises: as `choose`.
    """
    wanted = os.environ.get(RENDERER_VARIABLE, "auto") or "auto"
    if wanted not in ("auto", "llvm", "scalar"):
        raise UsageError(f"{RENDERER_VARIABLE} is '{wanted}', expected auto, llvm or scalar")
    if wanted == "scalar":
        return Backend("scalar", advice=None)
    probes: list[Probe] = []
    for library in libraries:
        probes.append(libllvm.cached_probe(library, attempt, refresh=refresh))
        if probes[-1].outcome == WORKS:
            return Backend("llvm", library, probes=tuple(probes))
    found = "; ".join(f"{p.library.name} {p.outcome}" for p in probes) or "no libLLVM"
    if wanted == "llvm":
        raise UsageError(f"{RENDERER_VARIABLE} is llvm, but found {found}; {INSTALL}")
    advice = f"rendering slowly, without LLVM (found {found}); {INSTALL}"
    return Backend("scalar", advice=advice, probes=tuple(probes))


def mitsuba(colour: str = "spectral", backend: Backend | None = None) -> Any:
    """Mitsuba with the variant for a kind of colour set; the first call warns once where it is slow.

    Args:
        colour: `spectral`, `rgb` or `mono`.
        backend: by default `choose()`.
    Raises:
        UsageError: no such kind of colour, or Mitsuba was built without the variant.
        RendererError: Mitsuba is missing, or Dr.Jit was imported with a libLLVM that does not work.
    """
    global _is_advised
    if colour not in _COLOURS:
        raise UsageError(f"no kind of colour is called '{colour}', expected {', '.join(_COLOURS)}")
    backend = backend or choose()
    if backend.advice is not None and not _is_advised:
        _is_advised = True
        warnings.warn(backend.advice, RendererWarning, stacklevel=2)
    mi = _import_mitsuba()
    variant = f"{'llvm_ad' if backend.is_llvm else 'scalar'}_{colour}"
    if variant not in mi.variants():
        raise UsageError(f"this Mitsuba has no variant {variant}, expected one of {', '.join(mi.variants())}")
    _require_same_process()
    if mi.variant() != variant:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            raise RendererError(
                f"Dr.Jit was imported while {LIBRARY_VARIABLE} named no libLLVM that works; set it to "
                f"{backend.library} before, or leave it unset"
            ) from error
    return mi


def _require_same_process() -> None:
    """Raise RendererError in a fork of a process that has used Mitsuba, whose threads would be waited for."""
    global _process
    _process = _process or os.getpid()
    if _process != os.getpid():
        raise RendererError(
            "Mitsuba cannot be used in a fork of a process that has used it; start processes by spawn: "
            'multiprocessing.get_context("spawn")'
        )


@contextmanager
def variant_kept() -> Iterator[None]:
    """Set the variant again that the user had set before the block; also a decorator."""
    mi = sys.modules.get("mitsuba")
    before = None if mi is None else mi.variant()
    try:
        yield
    finally:
        if mi is not None and before is not None and mi.variant() != before:
            mi.set_variant(before)


def mitsuba_of_any_variant() -> Any:
    """Mitsuba for what is alike in all variants, such as image files: with the variant that is set, or `scalar_rgb`."""
    mi = _import_mitsuba()
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    return mi


@contextmanager
def only_errors() -> Iterator[None]:
    """Mitsuba without its warnings, such as that of a rounded number of samples, which it prints on stdout."""
    mi = mitsuba_of_any_variant()
    before = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(before)


def on_variant(callback: Callable[[str], None]) -> None:
    """Call back with the variant that is set, if any, and with every one that is set later; never without Mitsuba."""
    if not is_available():
        return
    mi = _import_mitsuba()
    current = mi.variant()
    if current is not None:
        callback(current)
    mi.detail.add_variant_callback(lambda _old, new: callback(new))


def drjit() -> Any:
    """Dr.Jit, for arrays of the variant that `mitsuba` has set."""
    choose()
    import drjit as dr

    return dr


@contextmanager
def one_thread() -> Iterator[None]:
    """Dr.Jit without worker threads, which use a core while they wait: processor times then count work only."""
    dr = drjit()
    before = dr.thread_count()
    dr.set_thread_count(0)
    try:
        yield
    finally:
        dr.set_thread_count(before)
