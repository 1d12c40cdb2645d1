"""Chooses the Mitsuba backend: the newest libLLVM, or the scalar variants.

Mitsuba's fast variants compile with a libLLVM, which Dr.Jit loads. Versions 15 and 16 crash on some processors, so
the newest version from 17 on is used. Only this module imports Mitsuba and Dr.Jit; other modules call `mitsuba()` and
`drjit()`, which raise `RendererError` if Mitsuba is missing.

Caveats: Dr.Jit loads its libLLVM when it is imported, and cannot change it in the same process. The variant is a
setting of the whole process, so threads must not render in different variants at the same time, and objects of one
variant cannot be used in another. Neither survives a fork: use spawned processes.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from manifold.core.errors import RendererError, UsageError

RENDERER_VARIABLE = "MANIFOLD_RENDERER"
"""Environment variable that forces a backend: `llvm`, `scalar`, or `auto` (as if it were not set)."""

LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Dr.Jit's environment variable for the libLLVM to use; if it is set, this library is used."""

_LEAST_VERSION = 17
INSTALL = f"install libLLVM {_LEAST_VERSION} or newer (Debian: apt install libllvm19)"
_FOLDERS = (
    f"{sys.prefix}/lib", "/usr/lib/*-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/lib/llvm*/lib", "/usr/local/lib",
    "/usr/local/opt/llvm*/lib", "/opt/homebrew/opt/llvm*/lib",
)  # fmt: skip
_COLOURS = ("spectral", "rgb", "mono")


class RendererWarning(UserWarning):
    """Warns that Mitsuba runs its slow scalar variants, because no suitable libLLVM was found."""


@dataclass(frozen=True)
class Backend:
    """How Mitsuba runs in this process: in LLVM or in scalar variants.

    Attributes:
        kind: `llvm` (vectorised, compiled) or `scalar`.
        library: the libLLVM of an LLVM backend.
        advice: one line on what to install for faster renders; empty if nothing is missing.
    """

    kind: str
    library: Path | None = None
    advice: str | None = None

    @property
    def is_llvm(self) -> bool:
        """Return whether renders are vectorised."""
        return self.kind == "llvm"

    def to_json(self) -> dict[str, Any]:
        """Return the fields as plain values for JSON."""
        return {
            "kind": self.kind,
            "library": None if self.library is None else str(self.library),
            "advice": self.advice,
            "mitsuba": mitsuba_version(),
        }


def mitsuba_version() -> str:
    """Return the version of the installed Mitsuba, without importing it."""
    return metadata.version("mitsuba")


def find_library() -> Path | None:
    """Return the newest libLLVM of version 17 or later, judged by file names, or the one in `DRJIT_LIBLLVM_PATH`."""
    if named := os.environ.get(LIBRARY_VARIABLE):
        return Path(named)
    found = {path: _version(path) for folder in _FOLDERS for path in Path("/").glob(f"{folder[1:]}/libLLVM*")}
    return max(
        (path for path in found if found[path] >= _LEAST_VERSION), key=lambda p: found[p], default=None
    )


def _version(path: Path) -> int:
    """Return the main version in the name of a library or its link target; 0 for other files and parts of LLVM."""
    if not re.fullmatch(r"libLLVM(-\d[\d.]*)?(\.so[\d.]*|\.dylib)", path.name) or not path.is_file():
        return 0
    texts = (path.name, str(path.resolve()))
    return max((int(n) for text in texts for n in re.findall(r"(?i)llvm[^\d/]*/?(\d+)", text)), default=0)


@cache
def choose() -> Backend:
    """Choose the backend of this process: the newest libLLVM, or the scalar variants."""
    wanted = os.environ.get(RENDERER_VARIABLE, "auto")
    if wanted not in ("auto", "llvm", "scalar"):
        raise UsageError(f"{RENDERER_VARIABLE} is '{wanted}', expected auto, llvm or scalar")
    if wanted == "scalar":
        return Backend("scalar")
    library = find_library()
    if library is not None:
        os.environ[LIBRARY_VARIABLE] = str(library)  # Dr.Jit reads it once, as it is imported
        return Backend("llvm", library)
    if wanted == "llvm":
        raise UsageError(f"{RENDERER_VARIABLE} is llvm, but there is no libLLVM; {INSTALL}")
    return Backend("scalar", advice=f"rendering slowly, without LLVM; {INSTALL}")


def is_available() -> bool:
    """Return whether Mitsuba can be imported; only rendering and fits by `--bsdf` need it."""
    try:
        imported()
    except RendererError:
        return False
    return True


@cache
def imported() -> Any:
    """Import Mitsuba, in the variant that is set."""
    choose()
    try:
        import mitsuba
    except ImportError as error:
        raise RendererError(
            f"rendering, and fits by --bsdf, need Mitsuba, which is not installed ({error}); pip install "
            "'brdf-manifold[render]', on a platform for which Mitsuba has wheels"
        ) from error
    # Before the current folder, where `plugins/diffuse.so` would be loaded in place of Mitsuba's own.
    mi: Any = mitsuba
    mi.file_resolver().prepend(str(Path(mi.__file__).parent))
    return mi


@cache
def own_plugins() -> frozenset[str]:
    """Return the names of Mitsuba's own plugins."""
    folder = Path(imported().__file__).parent / "plugins"
    return frozenset(path.name.partition(".")[0] for path in folder.iterdir())


def is_registered(name: str) -> bool:
    """Return whether this process registered a plugin of that name from Python, without loading a library."""
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
    """Return the folders in which Mitsuba looks for files: its own, and the folder current at its import."""
    return [Path(str(folder)) for folder in imported().file_resolver()]


_process: int | None = None
_is_advised = False
_is_kept = False  # by a block of `variant_kept`


def mitsuba(colour: str = "spectral", backend: Backend | None = None) -> Any:
    """Set Mitsuba's variant for `spectral`, `rgb` or `mono` colours, and return the module.

    The first call warns if rendering is slow.
    """
    global _is_advised
    if colour not in _COLOURS:
        raise UsageError(f"no kind of colour is called '{colour}', expected {', '.join(_COLOURS)}")
    backend = backend or choose()
    if backend.advice is not None and not _is_advised:
        _is_advised = True
        warnings.warn(backend.advice, RendererWarning, stacklevel=2)
    mi = imported()
    variant = f"{'llvm_ad' if backend.is_llvm else 'scalar'}_{colour}"
    if variant not in mi.variants():
        raise UsageError(f"this Mitsuba has no variant {variant}, expected one of {', '.join(mi.variants())}")
    _require_same_process()
    if mi.variant() != variant:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            if not backend.is_llvm:
                raise
            raise RendererError(
                f"Dr.Jit cannot use {backend.library} ({str(error).strip().splitlines()[-1]}); name another libLLVM in "
                f"{LIBRARY_VARIABLE}, or set {RENDERER_VARIABLE}=scalar"
            ) from error
    return mi


def _require_same_process() -> None:
    """Raise RendererError in a fork of a process that has used Mitsuba, because its threads do not exist here."""
    global _process
    _process = _process or os.getpid()
    if _process != os.getpid():
        raise RendererError(
            "Mitsuba cannot be used in a fork of a process that has used it; start processes by spawn: "
            'multiprocessing.get_context("spawn")'
        )


@contextmanager
def variant_kept() -> Iterator[None]:
    """Restore the user's variant after the block; also usable as a decorator.

    Only the outermost of nested blocks restores it, because setting a variant takes 50 ms.
    """
    global _is_kept
    if _is_kept:
        yield
        return
    mi = sys.modules.get("mitsuba")
    before = None if mi is None else mi.variant()
    _is_kept = True
    try:
        yield
    finally:
        _is_kept = False
        if mi is not None and before is not None and mi.variant() != before:
            mi.set_variant(before)


def mitsuba_of_any_variant() -> Any:
    """Return Mitsuba for variant-independent work, such as image files, in the current variant or `scalar_rgb`."""
    mi = imported()
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    return mi


@contextmanager
def only_errors() -> Iterator[None]:
    """Silence Mitsuba's warnings, which it prints on stdout, for example about a rounded number of samples."""
    mi = mitsuba_of_any_variant()
    before = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(before)


def on_variant(callback: Callable[[str], None]) -> None:
    """Call a function with the current variant, if any, and with every variant that is set later."""
    if not is_available():
        return
    mi = imported()
    current = mi.variant()
    if current is not None:
        callback(current)
    mi.detail.add_variant_callback(lambda _old, new: callback(new))


def drjit() -> Any:
    """Return the module Dr.Jit, for arrays of the variant that `mitsuba` has set."""
    imported()
    import drjit as dr

    return dr


@contextmanager
def one_thread() -> Iterator[None]:
    """Run Dr.Jit, if it is loaded, without worker threads, which occupy a core while they wait."""
    dr = sys.modules.get("drjit")
    if dr is None:
        yield
        return
    before = dr.thread_count()
    dr.set_thread_count(0)
    try:
        yield
    finally:
        dr.set_thread_count(before)


@contextmanager
def two_threads() -> Iterator[None]:
    """Run Dr.Jit with at least one worker thread, without which Mitsuba 3.9 hangs while it writes OpenEXR."""
    dr = drjit()
    before = dr.thread_count()
    if before < 2:
        dr.set_thread_count(2)
    try:
        yield
    finally:
        if before < 2:
            dr.set_thread_count(before)
