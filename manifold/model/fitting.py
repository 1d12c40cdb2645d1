"""Latent spaces fitted to the materials of a library, from Gram matrices that are integrated in bounded memory."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.interface import BRDF, all_isotropic
from manifold.brdf.measured import MeasuredBRDF, values_at
from manifold.core import progress
from manifold.core.directions import from_spherical
from manifold.core.errors import UsageError
from manifold.core.mapping import ValueMapping
from manifold.core.names import counted
from manifold.core.pairs import Pairs, RusinkiewiczGrid, cosine_weight
from manifold.core.records import Array, evenly_spaced
from manifold.gp.likelihood import LatentObjective, centre_gram, require_start
from manifold.model.blend_fitting import BlendSamples, BlendTables, evaluate, fit_landmarks
from manifold.model.latent_space import LatentSpace
from manifold.model.material_space import MaterialSpace
from manifold.model.materials import MaterialCache
from manifold.model.settings import MOST_LAID_OUT, Settings
from manifold.registries import MAPPINGS

BLOCK_PAIRS = 1024  # direction pairs held at once: 51 materials x 195 bands x 1024 pairs are 80 MB


@dataclass(frozen=True, eq=False)
class Gram:
    """Inner products of samples in a mapped domain, not centred.

    Attributes:
        S: sum of weight * T(f_i) * T(f_j) over what a sample holds: direction pairs and bands of a material,
            shape (N, N); or direction pairs of a single band, shape (N B, N B), material by material.
        n_outputs: D, how many values a sample holds.
    """

    S: Array
    n_outputs: int


def value_blocks(
    materials: Sequence[BRDF], grid: RusinkiewiczGrid, block: int = BLOCK_PAIRS
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield wi (P, 3), wo (P, 3) above the horizon, and the values f of all materials, (N, P, B), over a grid.

    If a material is anisotropic, the grid is turned.
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

    Each pair is weighted by cos(theta_i) cos(theta_o), as in an image, and D counts pairs above the horizon. Without
    weights D counts the whole grid, as in eq. 22 of Hikichi & Iwasaki.
    """
    S = np.zeros((len(materials), len(materials)))
    n_outputs = 0
    total = -(-grid.n_pairs // BLOCK_PAIRS)
    for done, (wi, wo, f) in enumerate(value_blocks(materials, grid), start=1):
        cosines = cosine_weight(wi, wo)
        mapped = mapping.forward(f, np.broadcast_to(cosines, f.shape[:2]))
        if is_weighted:
            mapped = mapped * np.sqrt(cosines)[:, None]
        flat = mapped.reshape(len(materials), -1)
        S += flat @ flat.T
        n_outputs += flat.shape[1]
        progress.report(done, total, "direction pairs")
    return Gram(S, n_outputs if is_weighted else grid.n_pairs * materials[0].bands.count)


_LIT_DEG = np.array([0.0, 45.0])
# Measured materials reach a little above 1; reflectance factors taken for f are pi times as large.
_MOST_ALBEDO = 1.5

Statistics = dict[str, float]
"""Objective at start and end of a fit."""
Fitted = tuple[LatentSpace, Statistics, BlendSamples | None]
"""A space, its statistics, and of a map by landmarks the samples that it was fitted to."""


def fit_space(materials: MaterialCache, settings: Settings, latents: Array | None = None) -> Fitted:
    """Fit the kind of space that the settings ask for to all materials of a cache, or keep latents (N, Q)."""
    count, most = len(materials.names), len(materials.names) - 1
    if count < 2:
        raise UsageError(
            f"{materials.library.path.name}: found {counted(count, 'material')}, "
            "expected at least 2; import more"
        )
    if not 1 <= settings.latent_dim <= most:
        raise UsageError(
            f"{settings.latent_dim} latent dimensions for {count} materials, "
            f"expected {'1' if most == 1 else f'1 to {most}'}; choose fewer or import more"
        )
    if count > MOST_LAID_OUT and settings.kind != "blend":
        raise UsageError(
            f"{count} materials for kind {settings.kind}, expected at most {MOST_LAID_OUT}; use kind blend, or leave "
            "materials out"
        )
    if settings.kind != "blend":
        for material in materials.filled():
            _warn_if_bright(material)
    if latents is not None:
        return _keep_latents(materials, settings, latents)
    return _FITS[settings.kind](materials, settings)


class BrightMaterialWarning(UserWarning):
    """The directional albedo of a measured material is far above 1: its unit or its measurement is wrong."""


def _warn_if_bright(material: MeasuredBRDF) -> MeasuredBRDF:
    wi = from_spherical(np.deg2rad(_LIT_DEG), 0.0)
    some = evenly_spaced(material.bands.count, 3).tolist()
    most = float(material.select_bands(some).albedo(wi).max())
    if most > _MOST_ALBEDO:
        warnings.warn(
            f"{material.name} has a directional albedo of {most:.3g}, expected at most 1: check its unit, 1/sr, or "
            "exclude it; it is fitted unchanged",
            BrightMaterialWarning,
            stacklevel=4,
        )
    return material


def _fit_materials(materials: MaterialCache, s: Settings) -> Fitted:
    from manifold.gplvm import GPLVM  # imports scikit-learn, most of a second that predictions need not spend

    matrix = _gram(materials, s)
    fitted = GPLVM(
        s.latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, optimizer=s.optimizer, prior=s.prior,
        output_variance=1.0 if s.as_published else None, farthest_first=not s.as_published,
    ).fit_gram(matrix.S, matrix.n_outputs)  # fmt: skip
    space = MaterialSpace(fitted.embedding_, matrix.S, matrix.n_outputs, s.covariance())
    return (
        space,
        {"objective_start": float(fitted.objective_start_), "objective": float(fitted.objective_)},
        None,
    )


def _keep_latents(materials: MaterialCache, s: Settings, latents: Array) -> Fitted:
    if s.kind == "blend":
        raise UsageError(
            "found latents for kind blend, whose layout goes with its colours, expected kind gplvm"
        )
    X = require_start(latents, len(materials.names), s.latent_dim)
    matrix, variance = _gram(materials, s), 1.0 if s.as_published else None
    objective = LatentObjective(
        centre_gram(matrix.S), matrix.n_outputs, s.covariance(), s.prior, output_variance=variance
    ).value(X)  # fmt: skip
    space = MaterialSpace(X, matrix.S, matrix.n_outputs, s.covariance())
    return space, {"objective_start": objective, "objective": objective}, None


def _fit_blends(materials: MaterialCache, s: Settings) -> Fitted:
    bands, samples = evenly_spaced(materials.library.bands.count, s.sample_bands), None
    count = s.landmarks_of(len(materials.names))
    if count < len(materials.names):
        read = map(_warn_if_bright, materials.stream())
        appearance, samples = evaluate(read, bands, materials.is_isotropic)
        space, layout = fit_landmarks(appearance, samples, count, s.latent_dim, s.covariance())
    else:
        brdfs = [_warn_if_bright(material) for material in materials.filled()]
        space, layout = BlendTables.of(brdfs, bands).fit(s.latent_dim, s.covariance())
    return space, {"objective_start": layout.objective_start, "objective": layout.objective}, samples


_FITS = {"blend": _fit_blends, "gplvm": _fit_materials}


def _gram(materials: MaterialCache, s: Settings) -> Gram:
    """Return the Gram matrix of the materials, from the library's cache."""
    library, mapping = materials.library, MAPPINGS[s.mapping]
    grid = RusinkiewiczGrid.named(s.grid).suited_to(materials.is_isotropic)
    made_of = f"gram-3 {library.content_hash} {list(materials.names)} {mapping!r} {grid!r}"
    made_of += " as published" if s.as_published else ""
    key = hashlib.sha256(made_of.encode()).hexdigest()
    cached = library.cache_get(key)
    if cached is not None and cached["S"].shape == (len(materials.names),) * 2:
        return Gram(cached["S"], int(cached["n_outputs"][0]))
    matrix = gram_matrix(materials.filled(), mapping, grid, is_weighted=not s.as_published)
    library.cache_put(key, {"S": matrix.S, "n_outputs": np.array([matrix.n_outputs])})
    return matrix
