"""Find a libLLVM that Dr.Jit can use, by trying it in a child process: some versions abort on some processors."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

_PROBE = """
import mitsuba as mi
mi.set_variant("llvm_ad_spectral")
bsdf = mi.load_dict({"type": "principled", "roughness": 0.3})
si = mi.SurfaceInteraction3f()
si.wi = mi.Vector3f(0, 0, 1)
si.wavelengths = mi.Spectrum(400.0, 500.0, 600.0, 700.0)
print(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0.6, 0.8)))
"""


def candidates() -> list[Path]:
    """Versions of libLLVM that the linker knows, newest first."""
    listing = subprocess.run(["ldconfig", "-p"], capture_output=True, text=True, check=False).stdout
    found: dict[int, Path] = {}
    for version, path in re.findall(r"libLLVM(?:-|\.so\.)(\d+)\S* .*=> (\S+)", listing):
        found.setdefault(int(version), Path(path))
    return [found[version] for version in sorted(found, reverse=True)]


def use_newest() -> Path | None:
    """Point Dr.Jit at the newest libLLVM that survives the probe; None if none does."""
    for path in candidates():
        environment = os.environ | {"DRJIT_LIBLLVM_PATH": str(path)}
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, timeout=120, check=False
        )
        if probe.returncode == 0:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(path)
            return path
    return None
