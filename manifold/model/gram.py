"""Computes the inner products of mapped materials, `Y Y^T` in the likelihood, in bounded memory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.interface import BRDF, all_isotropic
from manifold.brdf.measured import values_at
from manifold.core import progress
from manifold.core.mapping import ValueMapping
from manifold.core.pairs import Pairs, RusinkiewiczGrid, cosine_weight
from manifold.core.records import Array
from manifold.model.materials import MaterialCache
from manifold.model.settings import GplvmSettings
from manifold.registries import MAPPINGS

BLOCK_PAIRS = 1024  # direction pairs held at once: 51 materials x 195 bands x 1024 pairs are 80 MB
_PROBED = np.geomspace(1e-4, 1e4, 17)  # values in 1/sr that tell one mapping from another


@dataclass(frozen=True, eq=False)
class Gram:
    """The Gram matrix of materials in a mapped domain, not centred.

    Attributes:
        S: sum of weight * T(f_i) * T(f_j) over direction pairs and bands, shape (N, N).
        n_outputs: D, the number of direction pairs times the number of bands.
    """

    S: Array
    n_outputs: int


def value_blocks(
    materials: Sequence[BRDF], grid: RusinkiewiczGrid, block: int = BLOCK_PAIRS
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield blocks of a grid above the horizon: wi (P, 3), wo (P, 3), and the values f (N, P, B) of all materials.

    If a material is anisotropic, the grid covers several incident azimuths.
    """
    for wi, wo, above in grid.suited_to(all_isotropic(materials)).blocks(block):
        if np.any(above):
            wi, wo = wi[above], wo[above]
            pairs = Pairs(wi, wo)
            yield wi, wo, np.stack([values_at(material, pairs) for material in materials])


def gram_matrix(
    materials: Sequence[BRDF],
    mapping: ValueMapping,
    grid: RusinkiewiczGrid,
    *,
    is_weighted: bool = True,
) -> Gram:
    """Return the Gram matrix of N materials of the same bands over a grid.

    Each direction pair is weighted by cos(theta_i) cos(theta_o), as in an image, and D counts the pairs above the
    horizon. If `is_weighted` is False, D counts the whole grid, as in eq. 22 of Hikichi & Iwasaki.
    """
    S = np.zeros((len(materials), len(materials)))
    n_outputs = 0
    total = -(-grid.n_pairs // BLOCK_PAIRS)
    for done, (wi, wo, f) in enumerate(value_blocks(materials, grid), start=1):
        cosines = cosine_weight(wi, wo)
        mapped = mapping.forward(f, cosines[:, None])
        if is_weighted:
            mapped = mapped * np.sqrt(cosines)[:, None]
        flat = mapped.reshape(len(materials), -1)
        S += flat @ flat.T
        n_outputs += flat.shape[1]
        progress.report(done, total, "direction pairs")
    return Gram(S, n_outputs if is_weighted else grid.n_pairs * materials[0].bands.count)


def cached_gram(materials: MaterialCache, s: GplvmSettings) -> Gram:
    """Return the Gram matrix of a library's materials for some settings, from the library's cache if possible."""
    library, mapping = materials.library, MAPPINGS[s.mapping]
    grid = RusinkiewiczGrid.named(s.grid).suited_to(materials.is_isotropic)
    mapped = np.round(
        mapping.forward(_PROBED, 0.5), 9
    ).tolist()  # another package may change what its name stands for
    made_of = f"gram-4 {library.content_hash} {list(materials.names)} {mapping.name} {mapped} {grid!r}"
    made_of += " as published" if s.as_published else ""
    key = hashlib.sha256(made_of.encode()).hexdigest()
    cached = library.cache_get(key)
    if cached is not None and cached["S"].shape == (len(materials.names),) * 2:
        return Gram(cached["S"], int(cached["n_outputs"][0]))
    matrix = gram_matrix(materials.filled(), mapping, grid, is_weighted=not s.as_published)
    library.cache_put(key, {"S": matrix.S, "n_outputs": np.array([matrix.n_outputs])})
    return matrix
