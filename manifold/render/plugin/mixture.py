"""The mixture that the plugin evaluates: materials and their weights."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from manifold.core.errors import UsageError
from manifold.core.mapping import ValueMapping
from manifold.core.records import AnyArray, Array, Bands, Indices
from manifold.gpr import GaussianProcess
from manifold.model.blend_space import BlendSpace
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.manifold import Manifold
from manifold.model.places import Place
from manifold.render.plugin import packed_tables
from manifold.render.plugin.packed_tables import PackedTables

_NO_TOLERANCE = "tolerance needs a Gram matrix of whole materials; leave it out, or embed with kind `gplvm`"

_STEP = 1e-5  # step of central differences of weights, in length scales of latents and units of colours

SEEN_NM = (360.0, 830.0)
"""Wavelengths that Mitsuba renders."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A weighted sum of N materials under a mapping.

    Attributes:
        mapping: the mapping T.
        bands: bands of the prediction.
        weights: weights of whole materials, (N,), or of single bands, (B, N, B_s); None if the latent varies.
        lobes: shares of the materials in sampling, (N,), which are positive and sum to 1.
        gp: the Gaussian process that turns varying latents into weights.
        order: index of each material in the model, (N,); empty for a measured file, whose unmeasured cells are
            kept.
        slopes: derivatives of the weights in the latent's coordinates and in the colour of a band; empty if not needed.
        is_blend: whether varying weights come from `blend_weights` instead of the Gaussian process.
        is_clipped: whether negative values become 0, as in predicted files; a measured file keeps them, because they
            are colours outside sRGB.
        left_out: number of materials that were skipped.
        left_out_error: relative change of the mapped values by skipping them.
    """

    names: tuple[str, ...]
    tables: PackedTables
    mapping: ValueMapping
    bands: Bands
    weights: Array | None
    lobes: Array
    gp: GaussianProcess | None = None
    order: Sequence[int] = ()
    slopes: Sequence[Array] = ()
    is_blend: bool = False
    is_clipped: bool = True
    left_out: int = 0
    left_out_error: float = 0.0

    def __str__(self) -> str:
        left = f", {self.left_out} left out at an error of {self.left_out_error:.2g}" if self.left_out else ""
        return f"{len(self.names)} materials{left}, {self.bands}, mapping {self.mapping.name}"


@dataclass(frozen=True, eq=False)
class FixedLatent:
    """One latent and its colours in double precision, which Mitsuba holds in single precision.

    Attributes:
        latent: latent, shape (Q,).
        colours: colour coordinates of a given colour, (B,); None without one.
        tolerance: allowed relative change by skipping materials; see `leave_out`.
    """

    model: Manifold
    latent: Array
    colours: Array | None
    tolerance: float = 0.0

    @classmethod
    def of(
        cls, model: Manifold, place: Place, colour: ColourChoice = NEAREST, tolerance: float = 0.0
    ) -> FixedLatent:
        """Return the latent of a point, with a given colour."""
        return cls(model, place.latent, model.choose_colour(place, colour).colours, tolerance)

    def moved(self, latent: AnyArray, colours: AnyArray | None) -> FixedLatent:
        """Return a changed latent (Q,) and changed colours (B,), given as float32.

        Values that equal a material's latent or the former values after rounding are replaced by these.
        """
        known = (self.latent, *self.model.X)
        exact = next((x for x in known if np.array_equal(np.float32(x), latent)), latent)
        if colours is not None and np.array_equal(np.float32(self.colours), colours):
            colours = self.colours
        return replace(self, latent=self.model.place(exact.tolist()).latent, colours=colours)

    def mixture(self, before: Mixture | None = None, *, has_slopes: bool = False) -> Mixture:
        """Return the mixture of the prediction or, at the latent of a material, of this material only.

        The materials of a mixture `before` of the same model are reused if they include all that are needed.
        """
        model, x, colours = self.model, self.latent, self.colours
        combination = model.combination(x, colours)
        sample_bands = combination.sample_bands
        if combination.source is not None:
            bands, seen = _seen_bands(model.bands)
            name, one = model.names[combination.source], np.ones(1)
            tables = packed_tables.pack([model.materials.measured_file(name)], seen)
            return Mixture((name,), tables, model.mapping, bands, one, one, is_clipped=False)
        S = model.space.arrays.get("S") if sample_bands is None else None
        if self.tolerance != 0.0 and S is None:
            raise UsageError(_NO_TOLERANCE)
        slopes = _slopes(model, x, colours) if has_slopes else []
        stack = np.stack([combination.weights, *slopes], axis=-1)  # [N, K] or [B, N B_s, K]
        left_out, error = 0, 0.0
        if sample_bands is None:
            kept, _, error = leave_out(combination.weights, S, self.tolerance)
            left_out = int(np.count_nonzero(combination.weights)) - len(kept)
            used = stack[kept] if S is None or left_out == 0 else _fitted_again(kept, stack, S)
            bands, tabled = _seen_bands(model.bands)
        else:
            kept = combination.used[0]
            by_material = stack.reshape(len(stack), len(model.names), len(sample_bands), -1)
            used = np.moveaxis(by_material[:, kept], 0, 1)  # [n, B, B_s, K]
            bands, tabled = model.bands, sample_bands.tolist()
        # An optimiser crosses the map: all at once, instead of new tables whenever another material gets a weight.
        has_all = has_slopes and self.tolerance == 0.0 and model.space.landmarks is None
        order, tables = _tables(model, range(len(model.names)) if has_all else kept, tabled, before)
        every = np.zeros((len(order), *used.shape[1:]))
        every[[order.index(k) for k in kept]] = used
        lobes = np.abs(every[..., 0]).reshape(len(order), -1).sum(axis=1)
        weights, *slopes = np.moveaxis(every if sample_bands is None else np.moveaxis(every, 0, 1), -1, 0)
        names = tuple(model.names[k] for k in order)
        return Mixture(
            names, tables, model.mapping, bands, weights, lobes / lobes.sum(),
            order=order, slopes=slopes, left_out=left_out, left_out_error=error,
        )  # fmt: skip


def _slopes(model: Manifold, x: Array, colours: Array | None) -> list[Array]:
    """Return slopes of the weights by each coordinate of x (Q,), and by a band's colour: Q or Q + 1 arrays.

    Weights are smooth functions that cost little, in double precision: central differences have nine digits.
    """
    ends = [((x + step, colours), (x - step, colours)) for step in _STEP * np.eye(len(x))]
    if colours is not None:
        ends.append(((x, colours + _STEP), (x, colours - _STEP)))
    weights = model.space.weights
    return [(weights(*above) - weights(*below)) / (2.0 * _STEP) for above, below in ends]


def varying_mixture(model: Manifold) -> Mixture:
    """Return a mixture of all materials, for latents that vary over a surface."""
    n = len(model.names)
    if model.space.landmarks is not None:
        raise UsageError(
            f"textures of latents on a map of {model.space.materials_in_words}, expected a map without landmarks, "
            "because all materials are kept in memory; embed fewer"
        )
    bands, seen = _seen_bands(model.bands)
    order, tables = _tables(model, range(n), seen)
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
    """Return the fewest materials that reproduce weights v (N,) within a tolerance, their new weights, and the error.

    The error is relative to the norm of the mapped values; a tolerance of 0 keeps all materials.

    The new weights u of the kept materials minimise `(u - v)^T S (u - v)`, the squared distance of the mapped values,
    with their Gram matrix S (N, N). Materials are removed one by one. Each step removes the material k that increases
    this distance least, by `u_k^2 / [S_kept^-1]_kk`.
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
    fitted = _fitted_again(kept, weights, S)
    change = -weights
    change[kept] += fitted
    return kept, fitted, float(np.sqrt(max(float(change @ S @ change), 0.0) / float(weights @ S @ weights)))


def _fitted_again(kept: Indices, weights: Array, S: Array) -> Array:
    """Return weights of kept materials, (n, ...), whose mapped values are nearest to those of all, (N, ...)."""
    return np.linalg.lstsq(S[np.ix_(kept, kept)], S[kept] @ weights, rcond=1e-12)[0].astype(np.float64)


def _tables(
    model: Manifold, materials: Iterable[int], bands: list[int], before: Mixture | None = None
) -> tuple[list[int], PackedTables]:
    """Return an order of the materials, and their tables; those of a mixture before are reused if they suffice."""
    known = [] if before is None else list(before.order)
    if before is not None and set(materials) <= set(known):
        return known, before.tables
    wanted = sorted({*map(int, materials), *known})
    with ThreadPoolExecutor() as pool:
        files = list(pool.map(lambda k: model.materials.filled_file(model.names[k]), wanted))
    # Materials with tables of equal sizes are neighbours.
    sizes = [(f.spectra.shape, f.vndf.shape, f.ndf.shape, f.sigma.shape, f.jacobian) for f in files]
    order = sorted(range(len(files)), key=sizes.__getitem__)
    return [wanted[k] for k in order], packed_tables.pack([files[k] for k in order], bands)


def _seen_bands(bands: Bands) -> tuple[Bands, list[int]]:
    """Return the bands that renders ask for, and their indices; Mitsuba's wavelengths go from 360 to 830 nm."""
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
