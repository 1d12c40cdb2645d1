"""Data of the page: materials in cube roots, packed, and the colour paths.

A prediction is `(sum_i v_i f_i^(1/3))^3` in every band. The cube roots of all materials are written in one spectral
basis of a few components, so that a blend of components is the blend of every band.
"""

from __future__ import annotations

import base64
import gzip
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.weighted_sums import WeightedSum
from manifold.colour import ball_colours
from manifold.colour.conversion import VISIBLE_NM, encode_srgb, to_srgb
from manifold.colour.environments import ENVIRONMENTS, environment
from manifold.colour.reflectances import srgb_spectra
from manifold.errors import UsageError
from manifold.latent.lobes import cos_theta_d
from manifold.model.blend_space import BlendSpace, require_blends
from manifold.model.manifold import Manifold
from manifold.model.walks import ROUGHNESSES, Walked, walk_path
from manifold.plots.explorer.direction_grid import (
    SLICE_INCIDENCES_DEG,
    AngleGrid,
    TabulatedPairs,
    tabulated_pairs,
)
from manifold.plots.explorer.uncertainty import error_field
from manifold.records import Array, Bands, Indices, evenly_spaced

ILLUMINANTS = ("D65", "A", "F11")

_COMPONENTS = 8  # of the spectral basis, at most
_NODES = 32  # visible bands that colours are made of, at most
_LEAST_WEIGHT = 0.3  # of a band in the basis, relative to the largest: paths include invisible bands
_DARK = 0.05  # of a material's median: ratios of components below this are not resolved
_FILE_NODES_NM = tuple(np.arange(380.0, 781.0, 10.0).tolist())  # of spectra that are dropped on an RGB map


@dataclass(frozen=True, eq=False)
class Tables:
    """Materials on the pairs of a page.

    Attributes:
        grid, pairs: which direction pairs.
        nodes: bands that colours and spectra are made of, indices, shape (J,).
        basis: the spectral basis at the nodes, shape (J, R).
        sample_basis: and at the bands that colour paths are made of, shape (B_s, R).
        components: cube roots of f cos(theta_i) cos(theta_o) in the basis, float32, shape (N, R, P).
        walked: the materials as ends of walks.
        at_nodes: which of their bands the nodes are, shape (J,).
    """

    grid: AngleGrid
    pairs: TabulatedPairs
    nodes: Indices
    basis: Array
    sample_basis: Array
    components: NDArray[np.float32]
    walked: list[Walked]
    at_nodes: Indices


def tabulate(model: Manifold) -> Tables:
    """Evaluate the materials of a map of blends, or its landmarks, on the pairs of a page.

    Raises:
        UsageError: the map is of another kind.
        LibraryError: a material cannot be read.
    """
    space = require_blends(model.space).of_landmarks
    grid = AngleGrid()
    pairs = tabulated_pairs(grid)
    nodes = _node_bands(model.bands)
    bands = np.union1d(nodes, space.bands)
    materials = model.materials.in_bands(bands.tolist(), _landmark_names(model))
    roots = np.stack([_roots(material, pairs) for material in materials])  # [N, P, B']
    at_nodes, at_samples = np.searchsorted(bands, nodes), np.searchsorted(bands, space.bands)
    basis, inverse = _spectral_basis(roots, _band_weights(model.bands, nodes, at_nodes, len(bands)))
    components = np.ascontiguousarray(np.moveaxis(roots @ inverse, 2, 1), dtype=np.float32)
    walked = [Walked.of(material) for material in materials]
    return Tables(grid, pairs, nodes, basis[at_nodes], basis[at_samples], components, walked, at_nodes)


def packed(tables: Tables) -> dict[str, Any]:
    """Components as text: the first as float16, the others as bytes, relative to the first.

    The first is positive, about the lightness; the others are about the chroma.
    """
    first = tables.components[:, 0]  # [N, P]
    bright = first > _DARK * np.median(first, axis=1, keepdims=True)
    ratio = np.divide(
        tables.components[:, 1:], first[:, None], out=np.zeros_like(tables.components[:, 1:]),
        where=first[:, None] > 0.0,
    )  # fmt: skip
    scale = np.where(bright[:, None], np.abs(ratio), 0.0).max(axis=2).astype(np.float32)  # [N, R - 1]
    scale[scale == 0.0] = 1.0
    steps = np.clip(np.rint(127.0 * ratio / scale[..., None]), -127, 127).astype(np.int8)
    return {"first": _text(first.astype("<f2")), "ratios": _text(steps), "scales": scale.tolist()}


def to_document(model: Manifold, tables: Tables) -> dict[str, Any]:
    """Everything that a page shows, as JSON."""
    space, names = require_blends(model.space).of_landmarks, _landmark_names(model)
    bands, nodes = model.bands, tables.nodes
    node_bands = bands if bands.is_rgb else Bands(tuple(np.array(bands.wavelengths_nm)[nodes].tolist()))
    grid, pairs = tables.grid, tables.pairs
    return {
        "library": model.library.path.name,
        "names": names,
        "others": _others(model),
        "X": space.X.tolist(),
        "lengthScale": space.kernel.length_scale,
        "anisotropic": [not model.library.attributes(name).is_isotropic for name in names],
        "unmeasured": [model.materials.unmeasured_share(name) for name in names],
        "grid": {
            "shape": list(grid.shape), "thetaHMax": grid.theta_h_max_rad, "thetaHPower": grid.theta_h_power,
            "thetaDShare": grid.theta_d_share,
        },
        "pairs": {
            "amplitude": _rounded(pairs.amplitude[pairs.n_grid :]), "grid": pairs.n_grid,
            "count": len(pairs.wi), "glossWeights": _rounded(pairs.gloss_weights),
            "sphereMeasure": pairs.sphere_measure.tolist(),
            "slices": [
                {"incidence": i, "angles": a.tolist()}
                for i, a in zip(SLICE_INCIDENCES_DEG, pairs.slice_angles_deg, strict=True)
            ],
        },
        "wavelengths": None if bands.is_rgb else list(node_bands.wavelengths_nm or ()),
        "nodes": nodes.tolist(),
        "basis": tables.basis.tolist(),
        "components": packed(tables),
        "toSrgb": {name: to_srgb(np.eye(node_bands.count), node_bands, name).tolist() for name in ILLUMINANTS},
        "fromSrgb": (np.eye(3) if bands.is_rgb else srgb_spectra(node_bands)).tolist(),
        "fileSpectra": _file_spectra() if bands.is_rgb else None,
        "reflectances": space.reflectances[:, nodes].tolist(),
        "paths": _paths(space, tables),
        "walks": _walks(tables),
        "environments": _environments(),
        "view": ball_colours.VIEW.tolist(),
        "error": error_field(model),
    }  # fmt: skip


def _environments() -> list[dict[str, Any]]:
    """The environments of the page: radiance in float16, row by row from the zenith."""
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
    """Places, colours and names of the materials that are no landmarks: points of the map, no part of predictions."""
    others = np.delete(np.arange(len(model.names)), model.landmarks)
    srgb = encode_srgb(np.clip(to_srgb(model.space.reflectances[others], model.bands), 0.0, 1.0))
    return {
        "X": model.X[others].round(3).tolist(),
        "colours": ["#" + bytes(np.rint(255.0 * colour).astype(np.uint8)).hex() for colour in srgb],
        "names": [model.names[k] for k in others],
    }


def _paths(space: BlendSpace, tables: Tables) -> dict[str, Any]:
    """Vertices of the colour paths; weights as indices of samples and values."""
    vertices = []
    for coordinates, samples, weights in space.paths.vertices:
        sparse = [[[int(samples[k]), float(w[k])] for k in np.flatnonzero(w)] for w in weights]
        vertices.append({"at": coordinates.tolist(), "weights": sparse})
    return {"vertices": vertices, "last": space.paths.last, "sampleBasis": tables.sample_basis.tolist()}


def _walks(tables: Tables) -> dict[str, Any]:
    """Highlights of the materials, and the shares of every two on their walk; the first and last are 0 and 1."""
    walked, cosines = tables.walked, (tables.pairs.wi[:, 2], tables.pairs.wo[:, 2])
    lobes = [one.highlight for one in walked]
    shares = [
        [walk_path(start, end)[1:-1].round(5).tolist() for end in walked[:k]]
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
    """Indices of at most 32 visible bands, evenly spread; of RGB bands all three."""
    if bands.wavelengths_nm is None:
        return np.arange(bands.count)
    nm = np.asarray(bands.wavelengths_nm)
    visible = np.flatnonzero((nm >= VISIBLE_NM[0]) & (nm <= VISIBLE_NM[1]))
    if len(visible) < 2:
        raise UsageError(
            f"{len(visible)} bands from {nm[0]:g} to {nm[-1]:g} nm are visible, expected at least 2"
        )
    return np.asarray(visible[evenly_spaced(len(visible), _NODES)])


def _roots(material: MeasuredBRDF, pairs: TabulatedPairs) -> Array:
    """Cube roots of f cos(theta_i) cos(theta_o), the mean of both sides of the plane of the normal, (P, B')."""
    mirror = np.array([1.0, -1.0, 1.0])
    total = np.zeros((len(pairs.wi), material.bands.count))
    half = WeightedSum([material], [0.5], cube_root=True)
    for side in (np.ones(3), mirror):
        half.add_to(total, DirectionPairs(pairs.wi * side, pairs.wo * side))
    return (np.maximum(total, 0.0) * pairs.amplitude[:, None]).astype(np.float32)


def _band_weights(bands: Bands, nodes: Indices, at_nodes: Indices, count: int) -> Array:
    """Weight of each band in colours, shape (B',); invisible bands have a small one."""
    weights = np.full(count, _LEAST_WEIGHT)
    if bands.wavelengths_nm is None:
        return np.ones(count)
    node_bands = Bands(tuple(np.array(bands.wavelengths_nm)[nodes].tolist()))
    seen = np.abs(to_srgb(np.eye(len(nodes)), node_bands)).sum(axis=1)
    weights[at_nodes] = np.maximum(np.sqrt(seen / seen.max()), _LEAST_WEIGHT)
    return weights


def _spectral_basis(roots: Array, weights: Array) -> tuple[Array, Array]:
    """Principal spectra (B', R) of cube roots (N, P, B'), and the matrix (B', R) that gives components."""
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
