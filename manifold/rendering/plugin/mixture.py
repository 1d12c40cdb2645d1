"""The mixture that the plugin evaluates: packed materials and their weights."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from manifold.errors import UsageError
from manifold.latent.gp_weights import GPWeights
from manifold.mapping import Mapping
from manifold.model.blend_space import BlendSpace
from manifold.model.colours import NEAREST, ColourChoice, choose_colour
from manifold.model.manifold import Manifold
from manifold.records import Array, Bands, BsdfFile, Indices
from manifold.rendering.plugin import packed_tables
from manifold.rendering.plugin.packed_tables import Tables

_NO_TOLERANCE = (
    "tolerance needs a Gram matrix of whole materials; leave it out, or embed with kind `material`"
)

SEEN_NM = (360.0, 830.0)
"""Wavelengths that Mitsuba renders."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A weighted sum of N materials under a mapping.

    Attributes:
        names: of the materials.
        tables: what they hold.
        mapping: T.
        bands: of the prediction.
        weights: of whole materials, (N,); of monochrome samples, (B, N, B_s); None where the latent varies.
        lobes: shares of the materials in sampling, (N,), positive, of sum 1.
        gp: what turns latents into weights, where they vary.
        order: index of each material in `gp`, (N,).
        is_blend: whether varying weights are those of `blend_weights` instead of the process's.
        is_clipped: whether negative values are cut, as in predicted files; a measured file keeps its own, which are
            colours outside sRGB.
        left_out: materials that were left out.
        left_out_error: what that changes, as a share of the norm of the mapped values.
    """

    names: tuple[str, ...]
    tables: Tables
    mapping: Mapping
    bands: Bands
    weights: Array | None
    lobes: Array
    gp: GPWeights | None = None
    order: Sequence[int] = ()
    is_blend: bool = False
    is_clipped: bool = True
    left_out: int = 0
    left_out_error: float = 0.0

    def __str__(self) -> str:
        left = f", {self.left_out} left out at an error of {self.left_out_error:.2g}" if self.left_out else ""
        return f"{len(self.names)} materials{left}, {self.bands}, mapping {self.mapping.name}"


def fixed_mixture(
    model: Manifold, latent: Sequence[float], colour: ColourChoice = NEAREST, tolerance: float = 0.0
) -> Mixture:
    """The prediction at a latent; at a training latent the measured file.

    Args:
        model: a fitted manifold.
        latent: Q coordinates.
        colour: on a monochrome manifold.
        tolerance: how much leaving materials out may change; see `leave_out`.
    Raises:
        LatentError: the latent does not have Q finite coordinates.
        UsageError: the manifold is monochrome and materials are to be left out, or it is not and a colour is chosen.
    """
    place = model.place(latent)
    x, chosen = place.latent, choose_colour(model, place, colour)
    combination = model.combination(x, chosen.colours)
    if combination.source is not None:
        return _of_materials(model, np.array([combination.source]), np.ones(1), 0, 0.0)
    weights, sample_bands = combination.weights, combination.sample_bands
    if sample_bands is None:
        S = model.space.arrays.get("S")
        if tolerance != 0.0 and S is None:
            raise UsageError(_NO_TOLERANCE)
        kept, fitted, error = leave_out(weights, S, tolerance)
        return _of_materials(model, kept, fitted, int(np.count_nonzero(weights)) - len(kept), error)
    if tolerance > 0.0:
        raise UsageError(_NO_TOLERANCE)
    used, combination = combination.used
    files = _read(model, used)
    order = _by_size(files)
    samples = combination.weights.reshape(model.bands.count, len(used), len(sample_bands))[:, order]
    lobes = np.abs(samples).sum(axis=(0, 2))
    tables = packed_tables.pack([files[k] for k in order], sample_bands.tolist())
    names = tuple(model.names[used[k]] for k in order)
    return Mixture(names, tables, model.mapping, model.bands, samples, lobes / lobes.sum())


def varying_mixture(model: Manifold) -> Mixture:
    """All materials, for latents that are known only where a surface is hit.

    Raises:
        UsageError: the manifold is monochrome (which colours give a structure its reflectance jumps between places,
            and would tear the field).
    """
    if model.space.needs_colours:
        raise UsageError(
            "textures of latents need a manifold of whole materials; give one latent, or embed as kind `blend`"
        )
    n = len(model.names)
    if model.space.landmarks is not None:
        raise UsageError(
            f"textures of latents on a map of {model.space.materials_in_words}, expected all to be laid out: they keep "
            "all in memory; embed fewer"
        )
    files = _read(model, range(n))
    order = _by_size(files)
    bands, seen = _seen_bands(model.bands)
    tables = packed_tables.pack([files[k] for k in order], seen)
    names, lobes = tuple(model.names[k] for k in order), np.full(n, 1.0 / n)
    return Mixture(
        names,
        tables,
        model.mapping,
        bands,
        None,
        lobes,
        model.gp,
        order,
        is_blend=model.space.kind == BlendSpace.kind,
    )


def leave_out(weights: Array, S: Array | None, tolerance: float) -> tuple[Indices, Array, float]:
    """The fewest materials that do for weights (N,), their new weights, and the relative error that remains.

    The new weights u of the kept ones minimise `(u - v)^T S (u - v)`, the squared distance of the mapped values.
    Materials go one by one, that first whose loss raises it least: of weight u_k, by `u_k^2 / [S_kept^-1]_kk`.

    Args:
        weights: v, shape (N,).
        S: Gram matrix of the mapped materials, shape (N, N); unused if the tolerance is 0.
        tolerance: largest error, as a share of the norm of the mapped values; 0 keeps all.
    Raises:
        UsageError: the tolerance is not from 0 to below 1.
    """
    if not 0.0 <= tolerance < 1.0:
        raise UsageError(f"tolerance is {tolerance:g}, expected a share from 0 to below 1, such as 0.01")
    kept = np.flatnonzero(weights)
    if tolerance == 0.0 or len(kept) == 1 or S is None:
        return kept, weights[kept], 0.0
    ridge = 1e-12 * np.trace(S) / len(S) * np.eye(len(kept))
    inverse = np.linalg.inv(S[np.ix_(kept, kept)] + ridge)
    u, most = weights[kept], tolerance**2 * (weights @ S @ weights)
    lost = 0.0
    while len(kept) > 1:
        loss = u**2 / np.diag(inverse)
        k = int(np.argmin(loss))
        if lost + loss[k] > most:
            break
        lost += loss[k]
        column = inverse[:, k] / inverse[k, k]
        u = np.delete(u - column * u[k], k)
        inverse = np.delete(np.delete(inverse - np.outer(column, inverse[k]), k, axis=0), k, axis=1)
        kept = np.delete(kept, k)
    fitted = np.linalg.lstsq(S[np.ix_(kept, kept)], S[kept] @ weights, rcond=1e-12)[0].astype(np.float64)
    change = -weights
    change[kept] += fitted
    return kept, fitted, float(np.sqrt(max(float(change @ S @ change), 0.0) / float(weights @ S @ weights)))


def _of_materials(model: Manifold, kept: Indices, weights: Array, left_out: int, error: float) -> Mixture:
    is_measured = len(kept) == 1 and weights[0] == 1.0
    files = [model.library.read(model.names[kept[0]])] if is_measured else _read(model, kept)
    order = _by_size(files)
    files, kept, weights = [files[k] for k in order], kept[order], weights[order]
    lobes = np.abs(weights) / np.abs(weights).sum()
    names = tuple(model.names[k] for k in kept)
    bands, seen = _seen_bands(model.bands)
    tables = packed_tables.pack(files, seen)
    return Mixture(
        names, tables, model.mapping, bands, weights, lobes,
        is_clipped=not is_measured, left_out=left_out, left_out_error=error,
    )  # fmt: skip


def _seen_bands(bands: Bands) -> tuple[Bands, list[int]]:
    """The bands that renders ask for, and their indices: Mitsuba's wavelengths go from 360 to 830 nm."""
    if bands.wavelengths_nm is None:
        return bands, list(range(bands.count))
    nm = np.asarray(bands.wavelengths_nm)
    first, last = np.searchsorted(nm, SEEN_NM[0], side="right") - 1, np.searchsorted(nm, SEEN_NM[1])
    seen = list(range(max(int(first), 0), min(int(last), len(nm) - 1) + 1))
    if len(seen) < 2:
        raise UsageError(
            f"{bands} cover nothing between {SEEN_NM[0]:g} and {SEEN_NM[1]:g} nm, the range of renders"
        )
    return bands.select(seen), seen


def _by_size(files: list[BsdfFile]) -> list[int]:
    """An order in which materials whose tables have the same sizes are neighbours."""

    def sizes(k: int) -> tuple[object, ...]:
        file = files[k]
        return (*(a.shape for a in (file.spectra, file.vndf, file.ndf, file.sigma)), file.jacobian)

    return sorted(range(len(files)), key=sizes)


def _read(model: Manifold, which: Iterable[int]) -> list[BsdfFile]:
    """Measured files as predictions combine them, unmeasured cells filled."""
    with ThreadPoolExecutor() as pool:
        return list(pool.map(lambda k: model.materials.filled_file(model.names[k]), which))
