"""The GGX distribution of microfacets as a linear map of one standard surface.

A surface of roughness 1 has D_std = 1 / pi. Stretching its geometry by a matrix M gives every isotropic,
anisotropic, rotated and skewed surface, and every quantity follows from transformed vectors:

    normals    w_std = M^T w_m / |M^T w_m|         D(w_m) = |det M| <w_std, n>^4 / <w_m, n>^4 / pi
    directions w'    = M^-1 w / |M^-1 w|           G1(w)  = 2 w'_z / (1 + w'_z)

Sources: Atanasov, Koylazov, Dimov & Wilkie 2022, "Microsurface Transformations"; Heitz 2014, "Understanding
the Masking-Shadowing Function" (height-correlated G2); Dupuy & Benyoub 2023, "Sampling Visible GGX Normals
with Spherical Caps".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from manifold.analytic.base import choose_lobe
from manifold.core.compiled import loops
from manifold.core.directions import gauss_legendre, half_vector, hemisphere_quadrature, normalize
from manifold.core.errors import ShapeError, UsageError
from manifold.core.records import Array, Indices
from manifold.core.threads import share_rows

# Sizes of the table of directional albedo; with these it is within 5e-4 of the exact integral for
# roughness 0.02 to 1 (tests/analytic/test_microfacet.py).
_N_ELEVATIONS = 96
_N_AZIMUTHS = 25
_N_COSINES = 257
_N_CAP = 64
_N_CAP_ANISOTROPIC = 32  # enough where the kink at the horizon is smeared over the azimuth


@dataclass(frozen=True, eq=False)
class GGX:
    """A GGX microsurface: the standard surface of roughness 1, its geometry stretched by a matrix.

    The third row and column of the matrix must be those of the identity. Otherwise the surface would have overhangs
    or another mean normal, and the masking would not be normalised. Only M M^T matters, so that a skewed map equals
    an anisotropic map along other axes; it is accepted so that the deformation of a mesh can be passed unchanged.

    Attributes:
        transform: M, shape (3, 3), with M[2] = M[:, 2] = (0, 0, 1); `GGX.skewed` embeds a 2x2 matrix.

    Raises:
        ShapeError: the transform is not a finite 3x3 matrix.
        UsageError: its third row or column is not (0, 0, 1), or it is singular.
    """

    transform: Array

    def __post_init__(self) -> None:
        m = np.array(self.transform, dtype=np.float64)
        if m.shape != (3, 3) or not np.all(np.isfinite(m)):
            raise ShapeError(f"transform has shape {m.shape}, expected a finite (3, 3) matrix")
        if not (np.array_equal(m[2], (0, 0, 1)) and np.array_equal(m[:, 2], (0, 0, 1))):
            found = f"third row {m[2].tolist()} and column {m[:, 2].tolist()}"
            raise UsageError(
                f"transform: found {found}, expected (0, 0, 1); give a map that only deforms the plane"
            )
        if not np.linalg.cond(m[:2, :2]) < 1e8:
            raise UsageError(f"transform {m[:2, :2].tolist()} is singular; give an invertible one")
        m.setflags(write=False)
        object.__setattr__(self, "transform", m)

    @classmethod
    def isotropic(cls, alpha: float) -> GGX:
        """Return the isotropic GGX surface with roughness `alpha` > 0, the width of the slope distribution."""
        return cls.anisotropic(alpha, alpha)

    @classmethod
    def anisotropic(cls, alpha_x: float, alpha_y: float, rotation_rad: float = 0.0) -> GGX:
        """Return the GGX surface with roughness `alpha_x` along an axis and `alpha_y` across it.

        The axis is turned by `rotation_rad` from x.
        """
        for name, alpha in (("alpha_x", alpha_x), ("alpha_y", alpha_y)):
            if not (np.isfinite(alpha) and alpha > 0):
                raise UsageError(f"{name} is {alpha}, expected a roughness above 0, such as 0.1")
        c, s = np.cos(rotation_rad), np.sin(rotation_rad)
        return cls.skewed(np.array([[c / alpha_x, -s / alpha_y], [s / alpha_x, c / alpha_y]]))

    @classmethod
    def skewed(cls, matrix: Array) -> GGX:
        """Return the surface stretched by any invertible map of the plane, shape (2, 2) or embedded in (3, 3)."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape == (2, 2):
            m = np.block([[m, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
        return cls(m)

    @property
    def is_isotropic(self) -> bool:
        """Return whether both roughnesses are equal (to 1e-12)."""
        alpha_x, alpha_y = self.alphas
        return abs(alpha_x - alpha_y) <= 1e-12 * alpha_x

    @property
    def alphas(self) -> tuple[float, float]:
        """Roughness along the two principal axes, the smaller first."""
        return self._principal[0]

    @cached_property
    def _principal(self) -> tuple[tuple[float, float], Array]:
        """Roughnesses and the rotation (2, 2) into their axes, from M M^T = R diag(1 / alpha^2) R^T."""
        a = self.transform[:2, :2]
        inverse_squares, axes = np.linalg.eigh(a @ a.T)
        alpha = 1.0 / np.sqrt(inverse_squares[::-1])
        if alpha[1] - alpha[0] <= 1e-12 * alpha[0]:
            return (float(alpha[0]), float(alpha[0])), np.eye(2)
        return (float(alpha[0]), float(alpha[1])), axes[:, ::-1].T

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.transform))

    @cached_property
    def _determinant(self) -> float:
        return abs(float(np.linalg.det(self.transform)))

    def stretched_length(self, w: Array) -> Array:
        """Return `|M^-1 w|`, shape (...); w_z divided by it is the cosine of the transformed direction."""
        return np.sqrt(_squared_length(self._inverse, w))

    def D(self, wm: Array) -> Array:
        """Return the density of microfacet normals in 1/sr per surface area, shape (...); 0 below the horizon.

        It is normalised so that the integral of D(wm) <wm, n> over the hemisphere is 1.
        """
        stretched = _squared_length(self.transform.T, wm)
        # <w_std, n>^4 / <w_m, n>^4 = 1 / |M^T w_m|^4, without the division by a grazing cosine.
        return np.where(wm[..., 2] > 0, self._determinant / (np.pi * stretched**2), 0.0)

    def masking(self, wi: Array, wo: Array) -> Array:
        """Return the height-correlated, symmetric G2 / (4 cos_i cos_o) above the horizon, shape (...)."""
        # The cosines are cancelled, so grazing directions lose no digits.
        return 0.5 / (wi[..., 2] * self.stretched_length(wo) + wo[..., 2] * self.stretched_length(wi))

    def reflection_factor(self, wi: Array, wo: Array) -> Array:
        """Return D G2 / (4 cos_i cos_o) in 1/sr, symmetric, for directions above the horizon, shape (...)."""
        return self.D(half_vector(wi, wo)) * self.masking(wi, wo)

    def sample_visible_normal(self, wi: Array, u: Array) -> Array:
        """Return microfacet normals (..., 3) that are visible from `wi` (..., 3), for variates u (..., 2).

        Their density is G1 <wi, wm> D / cos_i.

        Source: Dupuy & Benyoub 2023, listing 3.
        """
        w = normalize(wi @ self._inverse.T)
        phi = 2.0 * np.pi * u[..., 0]
        z = (1.0 - u[..., 1]) * (1.0 + w[..., 2]) - w[..., 2]
        r = np.sqrt(np.clip(1.0 - z * z, 0.0, 1.0))
        h = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1) + w
        return normalize(h @ self._inverse)  # M^-T h, row vectors

    def pdf_reflection(self, wi: Array, wo: Array) -> Array:
        """Return the density in 1/sr with which a random visible normal reflects `wi` to `wo`, shape (...)."""
        d = self.D(half_vector(wi, wo))
        return d / (2.0 * (self.stretched_length(wi) + wi[..., 2]))

    def albedo_table(self, reflectance: Array) -> AlbedoTable:
        """Return the directional albedo of single scattering for a Fresnel reflectance.

        Args:
            reflectance: Fresnel reflectance at `facet_cosines()`, shape (n_cosines, B).
        """
        return AlbedoTable(self, _facet_moments(*self.alphas) @ reflectance)

    def _table_coordinates(self, w: Array) -> tuple[Array, Array]:
        """Return the stretched polar angle and azimuth of directions (n, 3), both mapped to [0, 1]."""
        (alpha_x, alpha_y), rotation = self._principal
        plane = (w[:, :2] @ rotation.T) * (alpha_x, alpha_y)
        z = w[:, 2] / np.sqrt(plane[:, 0] ** 2 + plane[:, 1] ** 2 + w[:, 2] ** 2)
        elevation = np.arccos(np.clip(1.0 - 2.0 * z, -1.0, 1.0)) / np.pi
        # The distribution is even along both principal axes: one quadrant is enough.
        azimuth = np.arctan2(np.abs(plane[:, 1]), np.abs(plane[:, 0])) / (0.5 * np.pi)
        return elevation, azimuth


@dataclass(frozen=True, eq=False)
class AlbedoTable:
    """A table of the directional albedo over stretched polar angle and azimuth, (polar angles, azimuths, B).

    An isotropic surface has one azimuth.
    """

    ggx: GGX
    values: Array

    def __call__(self, w: Array) -> Array:
        """Return the albedo of directions (n, 3) above the horizon, shape (n, B), interpolated linearly."""
        elevation, azimuth = self.ggx._table_coordinates(w)
        n_rows, n_columns, n_bands = self.values.shape
        row, s = _cell(elevation, n_rows)
        flat = self.values.reshape(n_rows * n_columns, n_bands)
        if n_columns == 1:
            return _blend(flat[row], flat[row + 1], s)
        column, t = _cell(azimuth, n_columns)
        at = row * n_columns + column
        near = _blend(flat[at], flat[at + 1], t)
        return _blend(near, _blend(flat[at + n_columns], flat[at + n_columns + 1], t), s)

    @cached_property
    def hemispherical(self) -> Array:
        """Albedo under uniform illumination, the cosine-weighted mean over the hemisphere, shape (B,)."""
        n_phi = 1 if self.ggx.is_isotropic else 64
        nodes, weights = hemisphere_quadrature(128, n_phi)
        return (weights * nodes[:, 2]) @ self(nodes) / np.pi


@dataclass(frozen=True, eq=False)
class GGXMixture:
    """A mixture of isotropic GGX microsurfaces, as pairs (share of the area, roughness alpha).

    It can replace a `GGX`. The shares sum to 1.
    """

    parts: Sequence[tuple[float, float]]

    def __post_init__(self) -> None:
        shares = [share for share, _ in self.parts]
        if not all(share >= 0.0 for share in shares) or abs(sum(shares) - 1.0) > 1e-6:
            raise UsageError(f"shares are {shares}, expected numbers >= 0 with the sum 1")

    @property
    def is_isotropic(self) -> bool:
        """Return whether f is invariant under rotation of both directions about the normal."""
        return True

    @cached_property
    def _surfaces(self) -> tuple[tuple[float, GGX], ...]:
        return tuple((share, GGX.isotropic(alpha)) for share, alpha in self.parts)

    def reflection_factor(self, wi: Array, wo: Array) -> Array:
        """Return D G2 / (4 cos_i cos_o) in 1/sr, shape (...), for directions above the horizon."""
        return sum(share * ggx.reflection_factor(wi, wo) for share, ggx in self._surfaces)  # type: ignore[return-value]

    def sample_visible_normal(self, wi: Array, u: Array) -> Array:
        """Return normals (n, 3) for the same arguments as `GGX.sample_visible_normal`."""
        part, u = choose_lobe(np.array([share for share, _ in self.parts]), u)
        normals = np.empty_like(wi)
        for k, (_, ggx) in enumerate(self._surfaces):
            normals[part == k] = ggx.sample_visible_normal(wi[part == k], u[part == k])
        return normals

    def pdf_reflection(self, wi: Array, wo: Array) -> Array:
        """Return the density in 1/sr with which a random visible normal reflects `wi` to `wo`, shape (...)."""
        return sum(share * ggx.pdf_reflection(wi, wo) for share, ggx in self._surfaces)  # type: ignore[return-value]

    def albedo_table(self, reflectance: Array) -> MixedAlbedo:
        """Return the directional albedo of single scattering for a Fresnel reflectance.

        Args:
            reflectance: Fresnel reflectance at `facet_cosines()`, shape (n_cosines, B).
        """
        return MixedAlbedo([(share, ggx.albedo_table(reflectance)) for share, ggx in self._surfaces])


@dataclass(frozen=True, eq=False)
class MixedAlbedo:
    """The mean of tables of directional albedo, weighted by their shares; it can replace an `AlbedoTable`."""

    parts: Sequence[tuple[float, AlbedoTable]]

    def __call__(self, w: Array) -> Array:
        """Return the albedo of directions (n, 3) above the horizon, shape (n, B)."""
        return sum(share * table(w) for share, table in self.parts)  # type: ignore[return-value]

    @cached_property
    def hemispherical(self) -> Array:
        """Albedo under uniform illumination, shape (B,)."""
        return sum(share * table.hemispherical for share, table in self.parts)  # type: ignore[return-value]


def _squared_length(matrix: Array, w: Array) -> Array:
    """Return |A w|^2, shape (...), of a map A of the plane and vectors (..., 3)."""
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    (a, b, _), (c, d, _), _ = matrix
    return (a * x + b * y) ** 2 + (c * x + d * y) ** 2 + z * z


def facet_cosines() -> Array:
    """Return the cosines between direction and facet at which `GGX.albedo_table` needs the Fresnel reflectance."""
    return np.linspace(0.0, 1.0, _N_COSINES)


def normal_distribution(cos_theta_h: Array, alpha: float, tail: float) -> Array:
    """Return the density of microfacet normals in 1/sr; the integral of `D cos(theta_h)` over the hemisphere is 1.

    `D ~ (1 - (1 - alpha^2) cos^2(theta_h))^-tail` for alpha below 1; GGX has the exponent 2; smaller exponents give
    longer tails.

    Source: Burley 2012, "Physically-Based Shading at Disney", generalised Trowbridge-Reitz.
    """
    a2 = alpha * alpha
    norm = (tail - 1.0) * (1.0 - a2) / (np.pi * (a2 ** (1.0 - tail) - 1.0))
    return norm / (1.0 - (1.0 - a2) * cos_theta_h**2) ** tail


def sample_normals(u: Array, alpha: float, tail: float) -> Array:
    """Return normals (P, 3) of density `D cos(theta_h)` by `normal_distribution`, for uniform variates u (P, 2)."""
    a2 = alpha * alpha
    x = (a2 ** (1.0 - tail) * (1.0 - u[:, 1]) + u[:, 1]) ** (1.0 / (1.0 - tail))
    sin_squared = np.clip((x - a2) / (1.0 - a2), 0.0, 1.0)
    s, phi = np.sqrt(sin_squared), 2.0 * np.pi * u[:, 0]
    return np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - sin_squared)], axis=1)


def _cell(x: Array, n: int) -> tuple[Indices, Array]:
    """Return the index of the left node and the fraction past it, for x in [0, 1] over n even nodes."""
    position = x * (n - 1)
    left = np.clip(position.astype(np.intp), 0, n - 2)
    return left, position - left


def _blend(a: Array, b: Array, t: Array) -> Array:
    return a + t[:, None] * (b - a)


@lru_cache(maxsize=256)
def _facet_moments(alpha_x: float, alpha_y: float) -> Array:
    """Return the directional albedo as a linear map of the Fresnel reflectance at `facet_cosines()`, read-only.

    Its shape is (polar angles, azimuths, n_cosines).

    E(wi) is the mean of F(<wi, h>) G2 / G1(wi) over visible normals h, by Gauss-Legendre quadrature over the height
    of the cap and evenly spaced azimuths. F is linear between the cosines, so one table serves any Fresnel term.
    """
    isotropic = alpha_x == alpha_y
    t = np.linspace(0.0, 1.0, _N_ELEVATIONS)
    z = 0.5 * (1.0 - np.cos(np.pi * t))
    phi = np.linspace(0.0, 0.5 * np.pi, 1 if isotropic else _N_AZIMUTHS)
    r = np.sqrt(1.0 - z * z)[:, None]
    stretched = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z[:, None]), axis=-1)
    x, weights = gauss_legendre(_N_CAP if isotropic else _N_CAP_ANISOTROPIC)
    # Mirrored directions meet the horizon in the last alpha^2 of the cap: v^2 spreads that edge out.
    v = 0.5 * (x + 1.0)
    around = (
        np.pi * (np.arange(v.size if isotropic else 2 * v.size) + 0.5) / v.size
    )  # half of it mirrors the other
    flat, moments = stretched.reshape(-1, 3), np.empty((z.size * phi.size, _N_COSINES))
    cap = (1.0 - v * v, weights * v, np.cos(around), np.sin(around))
    share_rows(lambda k: loops.integrate_caps(flat[k], alpha_x, alpha_y, *cap, moments[k]), len(flat), 8)
    moments.setflags(write=False)
    return moments.reshape(z.size, phi.size, _N_COSINES)
