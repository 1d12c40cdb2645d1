"""The libLLVM files of a system: found, tested in a child process, with cached results.

Some versions are too old for Dr.Jit, and some abort the whole process on some processors, so each is first tried by a
child that evaluates a `measured` and a `principled` BSDF. Answers hold for a library file, a processor and a version of
Mitsuba.
"""

from __future__ import annotations

import json
import os
import platform
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np

from manifold.errors import UsageError
from manifold.io_rgl import write_bsdf
from manifold.records import BsdfFile
from manifold.system import atomic, temporary
from manifold.system.remembered import cache_folder

LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Dr.Jit's environment variable for the libLLVM to use; where it is set, that one is tried first."""

WORKS = "works"
INSTALL = "install libLLVM 16 or newer (Debian: apt install libllvm19)"

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
    with temporary.folder() as folder:
        material = folder / "probe_spec.bsdf"
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


def cached_probe(library: Path, attempt: Callable[[Path], str] = probe, *, refresh: bool = False) -> Probe:
    """The result of trying a library: the cached one, or that of a new attempt, which is cached.

    What tells of a busy machine rather than of the library is not remembered.

    Args:
        library: the file.
        attempt: tries it and returns `WORKS` or what happened.
        refresh: try it again, whatever is remembered.
    """
    key = _cache_key(library)
    remembered = None if refresh else _read_cache().get(key)
    if remembered is not None:
        return Probe(library, remembered, remembered=True)
    outcome = attempt(library)
    if not outcome.startswith((_NO_ANSWER, _NOT_TRIED, _STOPPED)):
        _remember(key, outcome)
    return Probe(library, outcome)


def cache_path() -> Path:
    """The file of remembered answers, in the user's cache folder."""
    return cache_folder() / "renderers.json"


def _cache_key(library: Path) -> str:
    """The cache key of a result: this version of the file, this processor, this version of Mitsuba."""
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
