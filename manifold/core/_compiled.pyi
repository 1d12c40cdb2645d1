"""The compiled loops, by their file in `cpp/`.

They run on one thread, outside the interpreter's lock. Arrays are C-contiguous; those that receive values have exactly
the type given here, others are converted where needed. ValueError: shapes do not fit; TypeError: types do not.
"""

from collections.abc import Sequence
from typing import Any

from manifold.core.records import Array

# evaluation.cpp

class Warp:
    """Densities (S, R, C) on the unit square, in single precision, with their cumulative sums; S slices are (P * T)."""

    def __init__(self, values: Any, phi_nodes: Any, theta_nodes: Any) -> None: ...

class Tables:
    """The tables of an RGL file, in single precision: ndf and sigma (R, C), spectra (S, H, W, B)."""

    def __init__(self, jacobian: bool, ndf: Any, sigma: Any, warp: Warp, spectra: Any) -> None: ...

# Directions and variates of pairs are rows in single or double precision, (K, n) or (1, n) of one for all.

def eval_pairs(
    wi: Array, wo: Array, isotropic: bool, repeats: int, divide: bool, tables: Tables, out: Any
) -> bool:
    """Write f at K pairs, or without `divide` f cos(theta_o), in all bands into out (K, B), double or single.

    Returns whether all directions are unit vectors, as do `pdf_of_pairs` and `sample_directions`.
    """

def eval_located(located: Array, tables: Tables, out: Array) -> None:
    """Write f at K pairs that are located, (K, 5), into out (K, B)."""

def add_located(
    located: Array, materials: Sequence[Tables], weights: Any, take_root: bool, total: Any
) -> None:
    """Add the sum of weights (M,) times f, or times cube roots of f, at K located pairs to total (K, B), single."""

def locate_pairs(wi: Array, wo: Array, isotropic: bool, repeats: int, out: Array) -> None:
    """Write `Pairs.located` of K pairs into out (K, 5)."""

def pdf_of_pairs(
    wi: Array, wo: Array, isotropic: bool, repeats: int, tables: Tables, luminance: Warp, out: Any
) -> bool:
    """Write densities of sampling wo from wi, K pairs, into out (K,), double or single."""

def sample_directions(
    wi: Array,
    uniforms: Array,
    isotropic: bool,
    repeats: int,
    tables: Tables,
    luminance: Warp,
    wo: Any,
    pdf: Any,
) -> bool:
    """Write outgoing directions of wi and uniforms into wo (K, 3), their densities into pdf (K,), double or single."""

def integrate(wi: Array, isotropic: bool, repeats: int, tables: Tables, out: Array) -> None:
    """Sum f cos(theta_o) / pdf of visible normals over rows of n x n points, for wi (K, 3), into out (K, n, B)."""

def map_points(mode: int, warp: Warp, phi: Array, theta: Array, points: Array, out: Array) -> None:
    """Write densities (mode 0), samples (1) or inverted samples (2) at points (K, 2), into out (K, 3)."""

def interpolate(table: Any, points: Array, out: Array) -> None:
    """Write values of an (R, C) table at points (K, 2) of the unit square into out (K,)."""

# models.cpp

def solve_nonnegative(gram: Array, cross: Array, tolerance: float, out: Array) -> None:
    """Write weights (R, n) >= 0 of atoms with inner products gram (n, n), of unit diagonal, and cross (R, n)."""

def explore(
    X: Array, K: Array, P: Array, S: Array, work: Array, state: Array, family: int, inverse_l2: float,
    n_outputs: float, prior: float, largest_drift: float, most_moves: float,
    steps: Array, heading: Array, lower: Array, upper: Array, index: int, budget: int,
) -> tuple[int, int, bool]:  # fmt: skip
    """Explore from coordinate `index` until P has drifted; return the next index, the moves tried, and that fact."""

def repel(X: Array, similarity: Array, force: Array) -> None:
    """Write the similarities (N,) of samples at positions X (Q, N) to all others, and the forces (Q, N) between them.

    Both are sums of powers of w = 1 + d^2 / 3 at distances d: of w^-2, and of w^-3 times the differences of positions.
    """

# surfaces.cpp

def project_facets(w: Array, m: Array, area: Array, out: Array) -> None:
    """Sum areas (M,) of facets with normals m (3, M) as seen from w (N, 3) into out (N,)."""

def add_shift(spectra: Any, measured: Any, ahead: Any, behind: Any, out: Any) -> None:
    """Write measured values (P, T, H, W, B), shifted by weights (4, n) times differences to neighbours, into out."""

def valley_depths(f: Array, dark: float, depth: Array) -> None:
    """Write `valley_depth` of profiles (K, D), into depth (K,); values below `dark` count as dark."""

def dequantise(coefficients: Any, basis: Any, least: float, values: Any) -> None:
    """Write cubes of sums of multiples of basis spectra into values (S, H, W, B)."""

def integrate_caps(
    stretched: Array, alpha_x: float, alpha_y: float, heights: Array, weights: Array, cos_phi: Array,
    sin_phi: Array, out: Array,
) -> None:  # fmt: skip
    """Write moments of G2 / G1 over visible normals, of stretched directions (n, 3), into out (n, n_cosines)."""

def reflect_conductor(cos_theta: Array, eta: Array, k: Array, parallel: Array, perpendicular: Array) -> None:
    """Write the Fresnel reflectance at cosines (n,) of indices (B,), into two arrays (n, B)."""

def reflect_film(cos_theta: Array, phase: Array, film: Array, eta: Array, k: Array, out: Array) -> None:
    """Write the reflectance of a film on a base at cosines (n,), into out (n, B)."""
