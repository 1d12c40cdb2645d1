"""Gram matrices of materials, by quadrature in bounded memory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.measured import BRDF, all_isotropic
from manifold.mapping import Mapping
from manifold.metrics import RusinkiewiczGrid, cosine_weight
from manifold.records import Array
from manifold.system import progress

BLOCK_PAIRS = 1024  # direction pairs held at once: 51 materials x 195 bands x 1024 pairs are 80 MB


@dataclass(frozen=True, eq=False)
class Gram:
    """Inner products of samples in a mapped domain, not centred.

    Attributes:
        S: sum of weight * T(f_i) * T(f_j) over what a sample holds: direction pairs and bands of a material,
            shape (N, N); or direction pairs of a single band, shape (N B, N B), material by material.
        n_outputs: D, how many values a sample holds above the horizon.
    """

    S: Array
    n_outputs: int


def value_blocks(
    materials: Sequence[BRDF], grid: RusinkiewiczGrid, block: int = BLOCK_PAIRS
) -> Iterator[tuple[Array, Array, Array]]:
    """Walk a grid: wi (P, 3), wo (P, 3) above the horizon, and the values f of all materials, (N, P, B).

    Where a material is anisotropic, the grid is turned.
    """
    for wi, wo, above in grid.suited_to(all_isotropic(materials)).blocks(block):
        if np.any(above):
            wi, wo = wi[above], wo[above]
            yield wi, wo, np.stack([material.eval(wi, wo) for material in materials])


def gram_matrix(
    materials: Sequence[BRDF],
    mapping: Mapping,
    grid: RusinkiewiczGrid,
) -> Gram:
    """Accumulate the Gram matrix of N materials of the same bands over a grid of direction pairs.

    Every pair counts by cos(theta_i) cos(theta_o), the weight it has in an image.
    """
    S = np.zeros((len(materials), len(materials)))
    n_outputs = 0
    total = -(-grid.n_pairs // BLOCK_PAIRS)
    for done, (wi, wo, f) in enumerate(value_blocks(materials, grid), start=1):
        cosines = cosine_weight(wi, wo)
        mapped = mapping.forward(f, np.broadcast_to(cosines, f.shape[:2])) * np.sqrt(cosines)[:, None]
        flat = mapped.reshape(len(materials), -1)
        S += flat @ flat.T
        n_outputs += flat.shape[1]
        progress.report(done, total, "direction pairs")
    return Gram(S, n_outputs)


def cache_key(
    content_hash: str,
    names: Sequence[str],
    mapping: Mapping,
    grid: RusinkiewiczGrid,
) -> str:
    """Name under which a library caches a Gram matrix of some materials: a hash of all that it depends on."""
    text = f"gram-3 {content_hash} {list(names)} {mapping!r} {grid!r}"
    return hashlib.sha256(text.encode()).hexdigest()
