"""OpenPBR by Adobe's own code, openpbr-bsdf, compiled from its headers, and values of it that tests compare with.

    OPENPBR_BSDF=FOLDER python tools/engines/openpbr_bsdf.py    write tests/data/openpbr_bsdf.json again

FOLDER is a checkout of github.com/adobe/openpbr-bsdf (Apache-2.0), which has openpbr.h; GLM is Debian's libglm-dev.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(REPOSITORY)]

from manifold.core.directions import from_spherical  # noqa: E402
from manifold.core.records import Array, Bands  # noqa: E402
from manifold.fit.exports import openpbr  # noqa: E402

VERSION = "a29da96"
REFERENCE = REPOSITORY / "tests" / "data" / "openpbr_bsdf.json"
_PAIRS = 24  # of each material; a third of them within some degrees of the mirror direction


def headers() -> Path:
    """Return the folder of Adobe's headers, which the variable OPENPBR_BSDF names."""
    named = os.environ.get("OPENPBR_BSDF", "")
    if not named or not (Path(named) / "openpbr.h").is_file():
        raise SystemExit(
            f"OPENPBR_BSDF is {named!r}, expected a checkout of github.com/adobe/openpbr-bsdf with openpbr.h; "
            f"get {VERSION} of it, and Debian's libglm-dev, or leave this engine out by --engine"
        )
    return Path(named)


@cache
def _compiled() -> Any:
    folder = tempfile.mkdtemp()
    library = Path(folder) / "openpbr_bsdf.so"
    source = Path(__file__).with_suffix(".cpp")
    command = [
        "c++",
        "-O2",
        "-std=c++17",
        "-shared",
        "-fPIC",
        "-I",
        str(headers()),
        str(source),
        "-o",
        str(library),
    ]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    if made.returncode:
        raise SystemExit(f"openpbr-bsdf does not compile: {made.stderr[-2000:]}")
    return ctypes.CDLL(str(library)).evaluate


def evaluate(values: Mapping[str, Any], wi: Array, wo: Array) -> Array:
    """Return f in 1/sr, (P, 3), of all parameters of `openpbr.DEFAULTS` at directions (P, 3) to viewer and light."""
    radians = {"geometry_tangent": np.deg2rad(values["geometry_tangent"])}
    numbers = [np.atleast_1d((values | radians)[name]) for name in openpbr.DEFAULTS]
    pairs = np.ascontiguousarray(np.concatenate([wi, wo], axis=1), np.float32)
    parameters, f = np.concatenate(numbers).astype(np.float32), np.zeros((len(wi), 3), np.float32)
    pointers = [a.ctypes.data_as(ctypes.POINTER(ctypes.c_float)) for a in (parameters, pairs, f)]
    _compiled()(pointers[0], pointers[1], len(wi), pointers[2])
    return f.astype(float)


@dataclass(frozen=True)
class AdobeBRDF:
    """OpenPBR's parameters as a BRDF in linear sRGB, by Adobe's code."""

    values: Mapping[str, Any]
    bands: Bands = Bands(None)  # noqa: RUF009
    is_isotropic: bool = True

    def eval(self, wi: Array, wo: Array) -> Array:
        """Return f in 1/sr, shape (..., 3); 0 below the horizon."""
        wi, wo = np.broadcast_arrays(wi, wo)
        f, above = np.zeros(wi.shape), (wi[..., 2] > 0.0) & (wo[..., 2] > 0.0)
        f[above] = evaluate(self.values, wi[above], wo[above])
        return f


MATERIALS: dict[str, dict[str, Any]] = {
    "diffuse": {"specular_weight": 0.0},
    "plastic": {"specular_ior": 1.7, "specular_roughness": 0.2},
    "weak and tinted": {"specular_weight": 0.4, "specular_color": [0.9, 0.5, 0.2], "specular_roughness": 0.6},
    "metal": {"base_metalness": 1.0, "specular_color": [0.6, 0.8, 1.0], "specular_roughness": 0.35},
    "half a metal": {"base_metalness": 0.5, "specular_roughness": 0.8, "specular_weight": 0.7},
    "brushed": {"base_metalness": 1.0, "specular_roughness_anisotropy": 0.7, "geometry_tangent": 30.0},
    "coated": {"coat_weight": 0.8, "coat_roughness": 0.3, "coat_ior": 1.8, "specular_ior": 1.3},
    "coated metal": {"base_metalness": 1.0, "coat_weight": 1.0, "coat_roughness": 0.5, "coat_darkening": 0.5},
    "fuzzy": {"fuzz_weight": 0.7, "fuzz_color": [0.2, 0.4, 0.9], "fuzz_roughness": 0.6, "coat_weight": 0.2},
    "film": {"thin_film_weight": 0.8, "thin_film_thickness": 0.35, "thin_film_ior": 1.8},
    "film on metal": {"base_metalness": 1.0, "thin_film_weight": 1.0, "thin_film_thickness": 0.6},
    "film under a coat": {"thin_film_weight": 1.0, "thin_film_ior": 1.3, "coat_weight": 0.6, "coat_ior": 1.5},
}  # fmt: skip
"""Parameters that differ from the defaults, each with a base colour of its own."""


def main() -> None:
    """Write the reference."""
    rng, materials = np.random.default_rng(0), []
    for name, changed in MATERIALS.items():
        values = openpbr.DEFAULTS | {"base_color": rng.uniform(0.05, 0.95, 3).round(3).tolist()} | changed
        theta, phi = np.arccos(rng.uniform(0.1, 1.0, (2, _PAIRS))), rng.uniform(0.0, 2.0 * np.pi, (2, _PAIRS))
        near = np.arange(_PAIRS) % 3 == 0
        theta[1, near] = np.clip(theta[0, near] + rng.normal(0.0, 0.1, near.sum()), 0.0, 1.5)
        phi[1, near] = phi[0, near] + np.pi + rng.normal(0.0, 0.1, near.sum())
        wi, wo = (from_spherical(t, p).round(7) for t, p in zip(theta, phi, strict=True))
        f = [[float(f"{x:.6g}") for x in row] for row in evaluate(values, wi, wo)]
        materials.append({"name": name, "values": values, "wi": wi.tolist(), "wo": wo.tolist(), "f": f})
    head = {
        "about": "f in 1/sr at unit vectors to viewer (wi) and light (wo), z the normal; films at 620, 540, 450 nm",
        "code": f"github.com/adobe/openpbr-bsdf at {VERSION}, Copyright 2026 Adobe, Apache-2.0",
        "command": "OPENPBR_BSDF=FOLDER python tools/engines/openpbr_bsdf.py",
    }
    rows = ",\n  ".join(json.dumps(material) for material in materials)
    text = json.dumps(head, indent=1).removesuffix("\n}") + f',\n "materials": [\n  {rows}\n ]\n}}\n'
    REFERENCE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
