"""Measured indices of refraction of metals and crystals, from the tables that Mitsuba ships.

Those of the metals in the built-in corpus lie beside this module, for where Mitsuba is missing.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.machinery import PathFinder
from pathlib import Path

import numpy as np

from manifold.colour.colour_science import frozen
from manifold.errors import FileFormatError, UsageError
from manifold.records import Array


def metal_names() -> tuple[str, ...]:
    """The materials `metal_ior` knows, sorted: element symbols and formulas such as `Au`, `Cr`, `TiN`."""
    return tuple(sorted(_ior_files()))


def metal_ior(name: str, wavelengths_nm: Array) -> tuple[Array, Array]:
    """Complex index of refraction eta + i k of a metal or crystal, relative to vacuum.

    Interpolated linearly between the table's wavelengths and held constant outside them: most tables end
    between 750 and 900 nm, so the last infrared bands of RGL files repeat the table's end.

    Args:
        name: one of `metal_names()`, such as `Au`.
        wavelengths_nm: wavelengths in nm, any shape.
    Returns:
        eta and k, both in the shape of `wavelengths_nm`.
    Raises:
        UsageError: there is no such table.
        FileFormatError: a table does not hold pairs of numbers.
    Source: the tables `data/ior/*.spd` of Mitsuba 3 (luxpop.com, SOPRA, Palik).

    >>> eta, k = metal_ior("Au", np.array([450.0, 650.0]))
    >>> eta.round(2), k.round(2)
    (array([1.51, 0.17]), array([1.88, 3.14]))
    """
    files = _ior_files()
    if name not in files:
        raise UsageError(f"no index of refraction named {name!r}; known: {', '.join(sorted(files))}")
    (eta_nm, eta), (k_nm, k) = (_read_spd(path) for path in files[name])
    known = eta > 0.0  # no medium has eta = 0: the tables of AlAs write it where a value is missing
    return np.interp(wavelengths_nm, eta_nm[known], eta[known]), np.interp(wavelengths_nm, k_nm, k)


@lru_cache(maxsize=1)
def _ior_files() -> dict[str, tuple[Path, Path]]:
    """The files of eta and k by material: our own, and Mitsuba's, which is looked up and not imported."""
    # Past sys.modules: an imported mitsuba that has set a variant no longer says where it lies.
    spec = PathFinder.find_spec("mitsuba")
    folders = [Path(p) / "data" / "ior" for p in (spec.submodule_search_locations or [])] if spec else []
    folders.insert(0, Path(__file__).with_name("ior"))
    found = {
        path.name.removesuffix(".eta.spd"): (path, path.with_name(path.name.replace(".eta.", ".k.")))
        for folder in folders
        for path in folder.glob("*.eta.spd")
    }
    return {name: pair for name, pair in found.items() if pair[1].is_file()}


@lru_cache(maxsize=256)
def _read_spd(path: Path) -> tuple[Array, Array]:
    """Wavelengths in nm, increasing, and values of a file of `wavelength value` lines."""
    try:
        table = np.loadtxt(path, comments="#", ndmin=2)
    except ValueError as error:
        raise FileFormatError(f"{path.name}: {error}; expected lines of `wavelength value`") from error
    if table.shape[1] != 2 or not np.all(np.diff(table[:, 0]) > 0):
        raise FileFormatError(f"{path.name}: expected two columns, wavelengths increasing; reinstall mitsuba")
    return frozen(table[:, 0].copy()), frozen(table[:, 1].copy())
