"""The compiled loops, by their file in `cpp/`.

They run on one thread, outside the interpreter's lock. Arrays are C-contiguous; those that receive values have exactly
the type given here, others are converted where needed. ValueError: shapes do not fit; TypeError: types do not.
"""

from collections.abc import Sequence
from typing import Any

from manifold.core.records import Array

# evaluation.cpp

class Tables:
    """The tables of an RGL file, in double precision but for spectra (S, H, W, B) in single; S slices are (P * T).

    Shapes: ndf and sigma (R, C), data and conditional (S, R, C), marginal (S, R), nodes (P,) and (T,).
    """

    def __init__(
        self, jacobian: bool, ndf: Array, sigma: Array, data: Array, conditional: Array, marginal: Array,
        phi_nodes: Array, theta_nodes: Array, spectra: Any,
    ) -> None: ...  # fmt: skip

def eval_pairs(
    wi: Array, wo: Array, isotropic: bool, reduction: int, divide: bool, tables: Tables, out: Array
) -> None:
    """Write f at K pairs (K, 3), or without `divide` f cos(theta_o), in all bands into out (K, B), double or single."""

def eval_located(located: Array, divide: bool, tables: Tables, out: Array) -> None:
    """Write `eval_pairs` at K pairs that are located, (K, 5)."""

def cube_roots(values: Any, out: Any) -> None:
    """Write signed cube roots of singles (K,), as `add_located` computes them, into out (K,)."""

def add_located(
    located: Array, materials: Sequence[Tables], weights: Any, take_root: bool, total: Any
) -> None:
    """Add the sum of weights (M,) times f, or times cube roots of f, at K located pairs to total (K, B), single."""

def locate_pairs(wi: Array, wo: Array, isotropic: bool, reduction: int, out: Array) -> None:
    """Write `Pairs.located` of pairs (K, 3) into out (K, 5)."""

def pdf_of_pairs(
    wi: Array, wo: Array, isotropic: bool, reduction: int, tables: Tables, luminance: Array, out: Array
) -> None:
    """Write densities of sampling wo from wi, K pairs, into out (K,); luminance is the `data` of the sampled warp."""

def sample_directions(
    wi: Array, uniforms: Array, isotropic: bool, reduction: int, tables: Tables, luminance: Array,
    conditional: Array, marginal: Array, wo: Array, pdf: Array,
) -> None:  # fmt: skip
    """Write outgoing directions of wi (K, 3) and uniforms (K, 2) into wo (K, 3), their densities into pdf (K,)."""

def integrate(wi: Array, isotropic: bool, reduction: int, tables: Tables, out: Array) -> None:
    """Sum f cos(theta_o) / pdf of visible normals over rows of n x n points, for wi (K, 3), into out (K, n, B)."""

def map_points(
    mode: int, data: Array, conditional: Array, marginal: Array, phi_nodes: Array, theta_nodes: Array,
    phi: Array, theta: Array, points: Array, out: Array,
) -> None:  # fmt: skip
    """Write densities (mode 0), samples (1) or inverted samples (2) at points (K, 2), into out (K, 3)."""

def interpolate(table: Any, points: Array, out: Array) -> None:
    """Write values of an (R, C) table at points (K, 2) of the unit square into out (K,)."""

# models.cpp

def solve_nonnegative(gram: Array, cross: Array, tolerance: float, out: Array) -> None:
    """Write weights (R, n) >= 0 of atoms with inner products gram (n, n), of unit diagonal, and cross (R, n)."""

def radial_of_pairs(family: int, squared: Array, out: Array) -> None:
    """Write `Kernel.radial` at squared distances in length scales (K,) into out (K,), by the kernel's index."""

def move_latent(
    X: Array, K: Array, P: Array, S: Array, work: Array, state: Array, family: int, inverse_l2: float,
    n_outputs: float, prior: float, largest_drift: float, most_moves: float, i: int, q: int, delta: float,
) -> bool:  # fmt: skip
    """Move latent i by delta along axis q; return whether P has drifted. `IncrementalObjective` has the arrays."""

def explore(
    X: Array, K: Array, P: Array, S: Array, work: Array, state: Array, family: int, inverse_l2: float,
    n_outputs: float, prior: float, largest_drift: float, most_moves: float,
    steps: Array, heading: Array, lower: Array, upper: Array, index: int, budget: int,
) -> tuple[int, int, bool]:  # fmt: skip
    """Explore from coordinate `index` until P has drifted; return the next index, the moves tried, and that fact."""

# surfaces.cpp

def project_facets(w: Array, m: Array, area: Array, out: Array) -> None:
    """Sum areas (M,) of facets with normals m (3, M) as seen from w (N, 3) into out (N,)."""

def add_shift(spectra: Any, measured: Any, ahead: Any, behind: Any, out: Any) -> None:
    """Write measured values (P, T, H, W, B), shifted by weights (4, n) times differences to neighbours, into out."""

def valley_depths(f: Array, dark: float, depth: Array) -> None:
    """Write `valley_depth` of profiles (K, D), into depth (K,); values below `dark` count as dark."""

def squared_valleys(
    roots: Array, allowed: Array, dark: float, value: Array, by_roots: Array, by_allowed: Array
) -> None:
    """Add squared valleys of blends (K, I, D, B) to value (K,), and write their gradients."""

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
