"""Prepares the data of the page: packed cube roots of the materials, and their colour paths.

A prediction is `(sum_i v_i f_i^(1/3))^3` in every band. The cube roots of all materials are written in one spectral
basis of a few components, so that a blend of components is the blend of every band.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manifold.analytic.free_lobes import cos_theta_d
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.sums import WeightedSum
from manifold.colour import ball_colours
from manifold.colour.conversion import VISIBLE_NM, encode_srgb, to_srgb, xyz_to_srgb
from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.colour.reflectances import srgb_spectra
from manifold.core.errors import UsageError
from manifold.core.judged_lights import BALL, LIGHTS
from manifold.core.pairs import Pairs
from manifold.core.records import Array, Bands, Indices, evenly_spaced
from manifold.model.blend_space import BlendSpace, require_blends
from manifold.model.expected_error import COARSE_BELOW
from manifold.model.manifold import Manifold
from manifold.model.walks import ROUGHNESSES, Walked, walk_shares
from manifold.page.page_surfaces import components_of, surface_document
from manifold.page.tabulated_pairs import (
    GRID_SHAPE,
    SLICE_INCIDENCES_DEG,
    THETA_D_SHARE,
    THETA_H_MAX_RAD,
    THETA_H_POWER,
    TabulatedPairs,
    tabulated_pairs,
)
from manifold.surface.written import WrittenSurface

_NODES = {1: 200, 2: 72, 3: 24}  # per dimension; maps of more dimensions have none
_MARGIN = 0.25  # width around the materials, as a share of their extent
_MOST_BALL = 15.0  # CIEDE2000 at which the ground of the map is darkest


def error_field(model: Manifold) -> dict[str, Any] | None:
    """Return errors on a regular grid over the map, with the last dimension fastest; None above three dimensions.

    They are the expected ball errors with a given colour and, for blends, with a blended colour. For a model that is
    not calibrated, they are the posterior over the prior standard deviation. The result also marks where the data do
    not support predictions.
    """
    X = model.X
    Q = X.shape[1]
    if Q not in _NODES:
        return None
    extent = np.maximum(np.ptp(X, axis=0), 1e-6)
    low, high = X.min(axis=0) - _MARGIN * extent, X.max(axis=0) + _MARGIN * extent
    axes = [np.linspace(a, b, _NODES[Q]) for a, b in zip(low, high, strict=True)]
    places = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    words: dict[str, Any]
    if model.left_out is None:
        words = {"what": "uncertainty", "unit": "posterior over prior standard deviation", "most": 1.0}
        values, blended = model.std(places), None
    else:
        coarse = f"; coarse, known from {len(X)} materials" if len(X) < COARSE_BELOW else ""
        words = {"what": "expected error", "unit": f"{BALL}{coarse}", "most": _MOST_BALL}
        values, blended = (
            model.left_out.expected(places, is_colour_known=is_known).ball for is_known in (True, False)
        )
    return words | {
        "low": low.tolist(), "high": high.tolist(), "nodes": _NODES[Q], "values": np.round(values, 3).tolist(),
        "blended": None if blended is None else np.round(blended, 3).tolist(),
        "unsupported": model.is_extrapolation(places).astype(int).tolist(),
    }  # fmt: skip


ILLUMINANTS = ("D65", "A", "F11")

_COMPONENTS = 8  # most components of the spectral basis
_MAP_NODES = 32  # visible bands that colours are made of, at most
_LEAST_WEIGHT = 0.3  # weight of invisible bands, which paths include, relative to the largest
_THUMBNAIL = 24  # pixels across
_DARK = 0.05  # share of a material's median below which ratios of components are not resolved
_FILE_NODES_NM = tuple(
    np.arange(380.0, 781.0, 10.0).tolist()
)  # wavelengths of spectra that are dropped on an RGB map


@dataclass(frozen=True, eq=False)
class PageTables:
    """The materials at the direction pairs of a page.

    Attributes:
        nodes: indices of the bands from which colours and spectra are computed, shape (J,).
        basis: the spectral basis at these bands, shape (J, R).
        sample_basis: the spectral basis at the sample bands of colour paths, shape (B_s, R).
        components: cube roots of f cos(theta_i) cos(theta_o) in the basis, float32, shape (N, R, P).
        walked: the materials as ends of walks.
        at_nodes: indices of the nodes among the bands of `walked`, shape (J,).
        thumbnails: pictures of the materials' balls in the studio, sRGB, extended to full squares, (N, S, S, 3).
    """

    pairs: TabulatedPairs
    nodes: Indices
    basis: Array
    sample_basis: Array
    components: NDArray[np.float32]
    walked: list[Walked]
    at_nodes: Indices
    thumbnails: NDArray[np.uint8]


def tabulate(model: Manifold) -> PageTables:
    """Evaluate the materials of a map of blends, or its landmarks, at the direction pairs of a page."""
    space = require_blends(model.space).of_landmarks
    pairs = tabulated_pairs()
    nodes = _node_bands(model.bands)
    bands = np.union1d(nodes, space.bands)
    materials = model.materials.in_bands(bands.tolist(), _landmark_names(model))
    roots = np.stack([_roots(material, pairs) for material in materials])  # [N, P, B']
    at_nodes, at_samples = np.searchsorted(bands, nodes), np.searchsorted(bands, space.bands)
    basis, inverse = _spectral_basis(roots, _band_weights(model.bands, nodes, at_nodes, len(bands)))
    components = np.ascontiguousarray(np.moveaxis(roots @ inverse, 2, 1), dtype=np.float32)
    walked = [Walked.of(material) for material in materials]
    thumbnails = np.stack([_thumbnail(material, at_nodes) for material in materials])
    return PageTables(
        pairs, nodes, basis[at_nodes], basis[at_samples], components, walked, at_nodes, thumbnails
    )


def _thumbnail(material: MeasuredBRDF, at_nodes: Indices) -> NDArray[np.uint8]:
    """Return a small ball, (S, S, 3), which the map shows until the page has drawn a finer one."""
    ball = ball_colours.ball(_THUMBNAIL)
    bands = material.bands
    if bands.wavelengths_nm is not None:
        bands = Bands(tuple(np.array(bands.wavelengths_nm)[at_nodes].tolist()))
    linear = xyz_to_srgb(ball.xyz(material.eval(ball.wi, ball.wo)[:, at_nodes], bands))
    across = (2.0 * np.arange(_THUMBNAIL) + 1.0) / _THUMBNAIL - 1.0
    x, y = np.meshgrid(across, -across)
    away = (x[..., None] - ball.places[:, 0]) ** 2 + (y[..., None] - ball.places[:, 1]) ** 2  # [S, S, K]
    return np.rint(255.0 * encode_srgb(np.clip(linear, 0.0, 1.0))).astype(np.uint8)[away.argmin(axis=2)]


def packed(components: NDArray[np.float32]) -> dict[str, Any]:
    """Return components (N, R, P) encoded as text: the first as float16, the others as bytes, relative to the first.

    The first component is positive and approximates the lightness; the others approximate the chroma.
    """
    first = components[:, 0]  # [N, P]
    bright = first > _DARK * np.median(first, axis=1, keepdims=True)
    ratio = np.divide(
        components[:, 1:], first[:, None], out=np.zeros_like(components[:, 1:]),
        where=first[:, None] > 0.0,
    )  # fmt: skip
    scale = np.where(bright[:, None], np.abs(ratio), 0.0).max(axis=2).astype(np.float32)  # [N, R - 1]
    scale[scale == 0.0] = 1.0
    steps = np.clip(np.rint(127.0 * ratio / scale[..., None]), -127, 127).astype(np.int8)
    return {"first": _text(first.astype("<f2")), "ratios": _text(steps), "scales": scale.tolist()}


def to_document(
    model: Manifold, tables: PageTables, surfaces: Sequence[WrittenSurface] = ()
) -> dict[str, Any]:
    """Return everything that a page shows, as JSON; the mean BRDFs of surfaces follow the materials in the tables."""
    space, names = require_blends(model.space).of_landmarks, _landmark_names(model)
    bands, nodes = model.bands, tables.nodes
    node_bands = bands if bands.is_rgb else Bands(tuple(np.array(bands.wavelengths_nm)[nodes].tolist()))
    pairs = tables.pairs
    means = [components_of(surface, node_bands, pairs, tables.basis)[None] for surface in surfaces]
    return {
        "library": model.library.path.name,
        "names": names,
        "thumbnails": {"side": _THUMBNAIL, "rgb": _text(tables.thumbnails)},
        "others": _others(model),
        "X": space.X.tolist(),
        "lengthScale": space.kernel.length_scale,
        "anisotropic": [not model.library.attributes(name).is_isotropic for name in names],
        "unmeasured": [model.materials.unmeasured_share(name) for name in names],
        "grid": {
            "shape": list(GRID_SHAPE), "thetaHMax": THETA_H_MAX_RAD, "thetaHPower": THETA_H_POWER,
            "thetaDShare": THETA_D_SHARE,
        },
        "pairs": {
            "amplitude": _rounded(pairs.amplitude[pairs.n_grid :]), "grid": pairs.n_grid,
            "count": len(pairs.wi),
            "glossWeights": _rounded(pairs.gloss_weights),
            "sphereMeasure": pairs.sphere_measure.tolist(),
            "slices": [
                {"incidence": i, "angles": a.tolist()}
                for i, a in zip(SLICE_INCIDENCES_DEG, pairs.slice_angles_deg, strict=True)
            ],
        },
        "lights": LIGHTS,
        "wavelengths": None if bands.is_rgb else list(node_bands.wavelengths_nm or ()),
        "nodes": nodes.tolist(),
        "basis": tables.basis.tolist(),
        "components": packed(np.concatenate([tables.components, *means])),
        "toSrgb": {name: to_srgb(np.eye(node_bands.count), node_bands, name).tolist() for name in ILLUMINANTS},
        "fromSrgb": (np.eye(3) if bands.is_rgb else srgb_spectra(node_bands)).tolist(),
        "fileSpectra": _file_spectra() if bands.is_rgb else None,
        "reflectances": space.reflectances[:, nodes].tolist(),
        "paths": _paths(space, tables),
        "walks": _walks(tables),
        "environments": _environments(),
        "view": ball_colours.VIEW.tolist(),
        "error": error_field(model),
        "coherence": None if model.coherence is None else model.coherence.statistics,
        "surfaces": [surface_document(surface, model) for surface in surfaces],
    }  # fmt: skip


def _environments() -> list[dict[str, Any]]:
    """Return the environments of the page: radiance in float16, row by row from the zenith."""
    made = []
    for name in ENVIRONMENTS:
        radiance = environment(name)
        rows, columns, _ = radiance.shape
        # Six bits of the fraction are enough for a light, and compress well.
        halves = (radiance.astype("<f2").view("<u2") + 8) & 0xFFF0
        made.append({"name": name, "rows": rows, "columns": columns, "radiance": _text(halves)})
    return made


def _landmark_names(model: Manifold) -> list[str]:
    return [model.names[k] for k in model.landmarks]


def _others(model: Manifold) -> dict[str, Any]:
    """Return points, colours and names of the materials besides landmarks, which predictions do not use."""
    others = np.delete(np.arange(len(model.names)), model.landmarks)
    srgb = encode_srgb(np.clip(to_srgb(model.space.reflectances[others], model.bands), 0.0, 1.0))
    return {
        "X": model.X[others].round(3).tolist(),
        "colours": ["#" + bytes(np.rint(255.0 * colour).astype(np.uint8)).hex() for colour in srgb],
        "names": [model.names[k] for k in others],
    }


def _paths(space: BlendSpace, tables: PageTables) -> dict[str, Any]:
    """Return the vertices of the colour paths; weights as indices of samples and values."""
    vertices = []
    for coordinates, samples, weights in space.paths.vertices:
        sparse = [[[int(samples[k]), float(w[k])] for k in np.flatnonzero(w)] for w in weights]
        vertices.append({"at": coordinates.tolist(), "weights": sparse})
    return {"vertices": vertices, "last": space.paths.last, "sampleBasis": tables.sample_basis.tolist()}


def _walks(tables: PageTables) -> dict[str, Any]:
    """Return highlights of the materials, and the shares of every two on their walk; the first and last are 0 and 1."""
    walked, cosines = tables.walked, (tables.pairs.wi[:, 2], tables.pairs.wo[:, 2])
    lobes = [one.highlight for one in walked]
    shares = [
        [walk_shares(start, end)[1:-1].round(5).tolist() for end in walked[:k]]
        for k, start in enumerate(walked)
    ]
    return {
        "positions": [lobe.position for lobe in lobes],
        "strengths": [lobe.strength for lobe in lobes],
        "roughnesses": ROUGHNESSES[:2].tolist(),
        "normal": [lobe.normal[tables.at_nodes].tolist() for lobe in lobes],
        "base": [lobe.base[tables.at_nodes].tolist() for lobe in lobes],
        "gain": [lobe.gain[tables.at_nodes].tolist() for lobe in lobes],
        "grazing": [lobe.grazing[tables.at_nodes].tolist() for lobe in lobes],
        "shares": shares,
        "toComponents": np.linalg.pinv(tables.basis).tolist(),
        "cosines": _text(np.stack([*cosines, cos_theta_d(tables.pairs.wi, tables.pairs.wo)]).astype("<f4")),
    }


def _node_bands(bands: Bands) -> Indices:
    """Return indices of at most 32 visible bands, evenly spread; of RGB bands all three."""
    if bands.wavelengths_nm is None:
        return np.arange(bands.count)
    nm = np.asarray(bands.wavelengths_nm)
    visible = np.flatnonzero((nm >= VISIBLE_NM[0]) & (nm <= VISIBLE_NM[1]))
    if len(visible) < 2:
        raise UsageError(
            f"{len(visible)} bands from {nm[0]:g} to {nm[-1]:g} nm are visible, expected at least 2"
        )
    return np.asarray(visible[evenly_spaced(len(visible), _MAP_NODES)])


def _roots(material: MeasuredBRDF, pairs: TabulatedPairs) -> Array:
    """Return cube roots of f cos(theta_i) cos(theta_o), the mean of both sides of the plane of the normal, (P, B')."""
    mirror = np.array([1.0, -1.0, 1.0])
    half = WeightedSum([material], [0.5], cube_root=True)
    total = np.zeros((len(pairs.wi), material.bands.count), half.dtype)
    for side in (np.ones(3), mirror):
        half.add_to(total, Pairs(pairs.wi * side, pairs.wo * side))
    return (np.maximum(total, 0.0) * pairs.amplitude[:, None]).astype(np.float32)


def _band_weights(bands: Bands, nodes: Indices, at_nodes: Indices, count: int) -> Array:
    """Return the weight of each band in colours, shape (B',); invisible bands have a small one."""
    weights = np.full(count, _LEAST_WEIGHT)
    if bands.wavelengths_nm is None:
        return np.ones(count)
    node_bands = Bands(tuple(np.array(bands.wavelengths_nm)[nodes].tolist()))
    seen = np.abs(to_srgb(np.eye(len(nodes)), node_bands)).sum(axis=1)
    weights[at_nodes] = np.maximum(np.sqrt(seen / seen.max()), _LEAST_WEIGHT)
    return weights


def _spectral_basis(roots: Array, weights: Array) -> tuple[Array, Array]:
    """Return principal spectra (B', R) of cube roots (N, P, B'), and the matrix (B', R) that gives components."""
    weighted = roots.reshape(-1, roots.shape[2]) * weights.astype(np.float32)
    gram = (weighted.T @ weighted).astype(np.float64)
    vectors = np.linalg.eigh(gram)[1][:, ::-1][:, :_COMPONENTS]
    vectors = vectors * np.where(vectors.sum(axis=0) < 0.0, -1.0, 1.0)
    return vectors / weights[:, None], (vectors * weights[:, None]).astype(np.float32)


def _file_spectra() -> dict[str, Any]:
    bands = Bands(_FILE_NODES_NM)
    return {"wavelengths": list(_FILE_NODES_NM), "toSrgb": to_srgb(np.eye(bands.count), bands).tolist()}


def _rounded(values: Array) -> list[float]:
    return [float(f"{v:.7g}") for v in values]


def _text(values: NDArray[Any]) -> str:
    return base64.b64encode(gzip.compress(values.tobytes(), 9, mtime=0)).decode()
