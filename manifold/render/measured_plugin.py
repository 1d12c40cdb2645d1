"""Loads Mitsuba's plugin `measured` so that it does not rotate or mirror directions.

If an anisotropic file covers a half or a quarter of the azimuths, the plugin folds incident azimuths into this range.
For an isotropic file, the number of repetitions (`m_reduction`) is not initialised. Whether an instance evaluates
directions as they are, rotates them by half a turn (which changes values by rounding) or mirrors them (which exchanges
the noise of both sides of the plane of incidence) depends on earlier contents of the memory.

Source: https://github.com/mitsuba-renderer/mitsuba3/pull/1850, open for Mitsuba 3.9.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from manifold.core.records import Array
from manifold.formats.tensor_file import read_tensors

MOST_INSTANCES = 64  # that are loaded for one that folds nothing; of black files all look folded
_PROBES = 64  # pairs of directions; rounding of a half turn shows in a third of them


def load_bsdf(mi: Any, content: Mapping[str, Any] | Any) -> Any:
    """Load a BSDF of Mitsuba in the current variant, without the bug of isotropic `measured` BSDFs.

    Mitsuba's own instances may rotate or mirror directions; the loaded one does not.

    Args:
        mi: the module `mitsuba`, with a variant set.
        content: a dictionary as for `mi.load_dict`, with the `filename` of a `measured` BSDF; a loaded BSDF is returned
            as it is.

    Raises:
        FileFormatError: the file of a `measured` BSDF is no RGL file, or is damaged.
        MissingFileError: there is no such file.
        RuntimeError: Mitsuba refuses the dictionary.
    """
    if not isinstance(content, Mapping):
        return content
    made = mi.load_dict(dict(content))
    if content["type"] != "measured" or len(read_tensors(Path(content["filename"]))["phi_i"]) > 2:
        return made
    folded: list[Any] = []  # kept, so that their memory is not used again
    while len(folded) < MOST_INSTANCES and folds(mi, made):
        folded.append(made)
        made = mi.load_dict(dict(content))
    return made


def folds(mi: Any, bsdf: Any) -> bool:
    """Return whether an isotropic BSDF has exactly the same values if both directions are rotated by 180 degrees.

    Otherwise the values differ by rounding, because the azimuths differ.
    """
    rng = np.random.default_rng(0)
    cos, azimuth = rng.uniform(0.1, 1.0, (2, _PROBES)), rng.uniform(-np.pi, np.pi, (2, _PROBES))
    sin = np.sqrt(1.0 - cos**2)
    wi, wo = np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), cos], axis=1).astype(np.float32)
    half_turn = np.array([[-1.0], [-1.0], [1.0]], np.float32)
    return np.array_equal(_values(mi, bsdf, wi, wo), _values(mi, bsdf, half_turn * wi, half_turn * wo))


def _values(mi: Any, bsdf: Any, wi: Array, wo: Array) -> Array:
    """Return f_cos at pairs of directions (3, K), whatever the variant."""
    context = mi.BSDFContext()
    if mi.variant().startswith("scalar"):
        si, values = mi.SurfaceInteraction3f(), []
        for i, o in zip(wi.T.tolist(), wo.T.tolist(), strict=True):
            _place(mi, si, mi.Vector3f(*i))
            values.append(np.array(bsdf.eval(context, si, mi.Vector3f(*o))))
        return np.array(values)
    si = mi.SurfaceInteraction3f()
    _place(mi, si, mi.Vector3f(wi))
    return np.array(bsdf.eval(context, si, mi.Vector3f(wo)))


def _place(mi: Any, si: Any, wi: Any) -> None:
    si.wi = wi
    if mi.is_spectral:
        si.wavelengths = mi.Spectrum(550.0)
