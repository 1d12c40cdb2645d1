"""The way to Mitsuba: an LLVM library that works, or the scalar variants with one line of advice.

Mitsuba's fast variants compile with a libLLVM that Dr.Jit finds on the machine. Some versions are too old, and some
abort the whole process on some processors, so every library is first tried in a child process that evaluates a
`measured` and a `principled` BSDF. Answers are remembered per library file, processor and version of Mitsuba.

This module (and nothing else) imports Mitsuba and Dr.Jit; others ask `mitsuba()` and `drjit()` for them.

Caveats: Dr.Jit takes its libLLVM when the first LLVM variant is set and never another one in the same process. The
variant is one setting of the whole process, so threads must not render in different ones at a time; objects of one
variant mean nothing in another. Neither survives a fork: use spawned processes.
"""

from __future__ import annotations

import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from manifold import atomic
from manifold.errors import UsageError
from manifold.io_rgl import write_bsdf
from manifold.records import BsdfFile

RENDERER_VARIABLE = "MANIFOLD_RENDERER"
"""Environment variable that forces a backend: `llvm`, `scalar`, or `auto` (as if it were not set)."""

LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Dr.Jit's environment variable for the libLLVM to use; where it is set, that one is tried first."""

WORKS = "works"
INSTALL = "install libLLVM 16 or newer (Debian: apt install libllvm19)"

_COLOURS = ("spectral", "rgb", "mono")
_TIMEOUT_S = 60.0
_NO_ANSWER, _NOT_TRIED, _STOPPED = "does not answer", "cannot be tried", "is stopped"
_FOLDERS = (
    "/usr/lib/*-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/lib/llvm*/lib", "/usr/local/lib", "/usr/local/opt/llvm/lib",
    "/opt/homebrew/opt/llvm*/lib",
)  # fmt: skip

# What a backend must be able to do; the file is in the first argument.
_PROBE = """
import sys
import mitsuba as mi
mi.set_variant("llvm_ad_spectral")
interaction = mi.SurfaceInteraction3f()
interaction.wi = mi.Vector3f(0, 0, 1)
interaction.wavelengths = mi.Spectrum(450.0, 500.0, 550.0, 600.0)
for scene in ({"type": "measured", "filename": sys.argv[1]}, {"type": "principled", "roughness": 0.3}):
    value = mi.load_dict(scene).eval(mi.BSDFContext(), interaction, mi.Vector3f(0, 0.6, [0.8, 0.8]))
    assert 0.0 < value.numpy().min() and value.numpy().max() < 10.0, "wrong values"
"""


class RendererWarning(UserWarning):
    """Rendering works, but slowly."""


@dataclass(frozen=True)
class Probe:
    """One libLLVM, and what became of the attempt to use it.

    Attributes:
        library: the file.
        outcome: `WORKS`, or what happened, in words.
        remembered: whether the answer is from an earlier attempt.
    """

    library: Path
    outcome: str
    remembered: bool = False


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


_chosen: Backend | None = None
_is_advised = False


def choose(*, refresh: bool = False) -> Backend:
    """The backend of this process: the first libLLVM that works, newest first, or the scalar variants.

    Args:
        refresh: try the libraries again, whatever is remembered of them.
    Raises:
        UsageError: `MANIFOLD_RENDERER` is none of its values, or asks for an LLVM that is not there.
    """
    global _chosen
    if _chosen is None or refresh:
        _chosen = choose_among(find_libraries(), probe, refresh=refresh)
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
    answers = {} if refresh else _read_cache()
    probes: list[Probe] = []
    for library in libraries:
        key = _cache_key(library)
        remembered = answers.get(key)
        probes.append(Probe(library, remembered or attempt(library), remembered is not None))
        if remembered is None and not _is_passing(probes[-1].outcome):
            _remember(key, probes[-1].outcome)
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
    """
    global _is_advised
    if colour not in _COLOURS:
        raise UsageError(f"no kind of colour is called '{colour}', expected {', '.join(_COLOURS)}")
    backend = backend or choose()
    if backend.library is not None:
        os.environ[LIBRARY_VARIABLE] = str(backend.library)
    if backend.advice is not None and not _is_advised:
        _is_advised = True
        warnings.warn(backend.advice, RendererWarning, stacklevel=2)
    import mitsuba as mi

    variant = f"{'llvm_ad' if backend.is_llvm else 'scalar'}_{colour}"
    if variant not in mi.variants():
        raise UsageError(f"this Mitsuba has no variant {variant}, expected one of {', '.join(mi.variants())}")
    if mi.variant() != variant:
        mi.set_variant(variant)
    return mi


def mitsuba_of_any_variant() -> Any:
    """Mitsuba for what is alike in all variants, such as image files: with the variant that is set, or `scalar_rgb`."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    return mi


def on_variant(callback: Callable[[str], None]) -> None:
    """Call back with the variant that is set, if any, and with every one that is set later."""
    import mitsuba as mi

    current = mi.variant()
    if current is not None:
        callback(current)
    mi.detail.add_variant_callback(lambda _old, new: callback(new))


def drjit() -> Any:
    """Dr.Jit, for arrays of the variant that `mitsuba` has set."""
    choose()
    import drjit as dr

    return dr


def mitsuba_version() -> str:
    """The version of Mitsuba that is installed, without importing it."""
    return metadata.version("mitsuba")


# -- finding --------------------------------------------------------------------------------------------------


def find_libraries() -> list[Path]:
    """The libLLVM files of this machine: what the user names first, then the newest version first."""
    named = os.environ.get(LIBRARY_VARIABLE)
    found = [*_known_to_the_linker(), *_in_folders(), *_in_packages()]
    unique: dict[Path, Path] = {}
    for path in found:
        unique.setdefault(path.resolve(), path)
    newest_first = sorted(unique.values(), key=_version, reverse=True)
    if not named:
        return newest_first
    first = Path(named)
    return [first, *(path for path in newest_first if path.resolve() != first.resolve())]


def _known_to_the_linker() -> list[Path]:
    try:
        listing = subprocess.run(["ldconfig", "-p"], capture_output=True, text=True, check=False).stdout
    except OSError:  # not everywhere on the search path
        return []
    return [Path(path) for path in re.findall(r"libLLVM\S* .*=> (\S+)", listing)]


def _in_folders() -> list[Path]:
    return [p for folder in _FOLDERS for p in Path("/").glob(f"{folder[1:]}/libLLVM*") if _is_library(p)]


def _in_packages() -> list[Path]:
    """Libraries that wheels bring along."""
    folders = [Path(entry) for entry in sys.path if entry.endswith("-packages")]
    patterns = ("*/libLLVM*", "*/lib/libLLVM*")
    return [p for f in folders for pattern in patterns for p in f.glob(pattern) if _is_library(p)]


def _is_library(path: Path) -> bool:
    """Whether a name is that of the whole shared library: no part of LLVM, no static archive."""
    return re.fullmatch(r"libLLVM(-\d[\d.]*)?(\.so[\d.]*|\.dylib)", path.name) is not None and path.is_file()


def _version(path: Path) -> tuple[int, ...]:
    """Version numbers in the name of a library, or in the names that its links lead to."""
    for name in (path.name, path.resolve().name, str(path)):
        numbers = re.findall(r"\d+", name.removeprefix("libLLVM"))
        if numbers:
            return tuple(int(n) for n in numbers)
    return (0,)


# -- trying ---------------------------------------------------------------------------------------------------


def probe(library: Path, timeout_s: float = _TIMEOUT_S) -> str:
    """Try a libLLVM in a child process: `WORKS`, or what happened in a few words."""
    if not library.is_file():
        return "is no file"
    environment = os.environ | {LIBRARY_VARIABLE: str(library)}
    with tempfile.TemporaryDirectory() as folder:
        material = Path(folder) / "probe_spec.bsdf"
        write_bsdf(material, _tiny_file())
        command = [sys.executable, "-c", _PROBE, str(material)]
        try:
            # In a folder of its own: an aborting child may leave a core file.
            child = subprocess.run(
                command, env=environment, cwd=folder, capture_output=True, text=True, errors="replace",
                timeout=timeout_s, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"{_NO_ANSWER} within {timeout_s:g} s"
        except OSError as error:
            return f"{_NOT_TRIED} ({error.strerror})"
    if child.returncode == 0:
        return WORKS
    if child.returncode == -signal.SIGKILL:
        return f"{_STOPPED} from outside (SIGKILL; was memory short?)"
    if child.returncode < 0:
        return f"kills the process ({_signal_name(-child.returncode)})"
    if old := re.search(r"version \((\d+)\) is too old", child.stderr):
        return f"is too old (version {old[1]})"
    lines = child.stderr.strip().splitlines() or ["no message"]
    return f"fails ({lines[-1][:80].strip()})"


def _is_passing(outcome: str) -> bool:
    """Whether an outcome tells of a busy machine rather than of the library, and is to be tried again."""
    return outcome.startswith((_NO_ANSWER, _NOT_TRIED, _STOPPED))


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _tiny_file() -> BsdfFile:
    """A diffuse material of the least size that Mitsuba reads."""
    theta = np.linspace(0.0, np.pi / 2, 2, dtype=np.float32)
    ones = np.ones((1, 2, 4, 4), dtype=np.float32)
    return BsdfFile(
        name="probe",
        description="probe",
        version=(3, 1),
        phi_i_rad=np.zeros(1, np.float32),
        theta_i_rad=theta,
        wavelengths_nm=np.linspace(400, 700, 4, dtype=np.float32),
        sigma=np.ones((4, 4), np.float32),
        ndf=np.ones((4, 4), np.float32),
        vndf=ones,
        luminance=ones,
        spectra=np.ones((1, 2, 4, 4, 4), np.float32),
        jacobian=True,
        valid=np.packbits(np.ones(ones.size, bool)),
    )


# -- remembering ----------------------------------------------------------------------------------------------


def cache_path() -> Path:
    """The file of remembered answers, in the user's cache folder."""
    root = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(root).expanduser() / "manifold" / "renderers.json"


def _cache_key(library: Path) -> str:
    """What an answer holds for: this file as it is, on this processor, with this Mitsuba."""
    try:
        status = library.stat()
        state = f"{status.st_size} bytes, changed {status.st_mtime_ns}"
    except OSError:
        state = "missing"
    return f"{library.absolute()}, {state}, {_processor()}, mitsuba {mitsuba_version()}"


def _processor() -> str:
    """The processor's model, with the family and model numbers that generic names leave out."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    found = dict(re.findall(r"^(cpu family|model|model name|stepping)\s*: (.*)$", text, flags=re.MULTILINE))
    return ", ".join(f"{key} {value}" for key, value in sorted(found.items())) or platform.machine()


def _read_cache() -> dict[str, str]:
    try:
        content = json.loads(cache_path().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(content, dict):
        return {}
    return {key: value for key, value in content.items() if isinstance(value, str)}


def _remember(key: str, outcome: str) -> None:
    """Add an answer to the cache; one that cannot be written costs time only."""
    path = cache_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic.write_text(path, json.dumps(_read_cache() | {key: outcome}, indent=1) + "\n")
    except (OSError, UsageError):
        return
