"""Errors between BRDFs, and the grids of direction pairs they are measured on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from manifold.directions import from_rusinkiewicz, rotate_z
from manifold.errors import ShapeError, UsageError
from manifold.records import Array, Mask

_LEAST_SQUARED_NORM = 1e-200  # of what is not black
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def rmse(f: Array, f_star: Array, *, n_pairs: float | None = None) -> float:
    """Root of the squared error, summed over bands and divided by the number of direction pairs only.

    `sqrt(sum_d (f_d - f*_d)^2 / n_pairs)`: bands are summed, not averaged.

    Args:
        f: measured values in 1/sr, shape (..., B), bands last.
        f_star: predicted values, same shape.
        n_pairs: number of direction pairs to divide by; those passed, if None. Give the size of the whole
            grid where pairs below the horizon (error 0) were left out.
    Raises:
        ShapeError: the shapes differ.
    Source: Hikichi & Iwasaki, eq. 22.

    >>> rmse(np.array([[3.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 4.0], [0.0, 0.0]])).__round__(6)
    3.535534
    """
    errors = _errors_of(f, f_star, 1.0)
    return float(errors.rmse(errors.n_pairs if n_pairs is None else n_pairs))


def relative_error(f: Array, f_star: Array, weight: Array | float = 1.0) -> float:
    """`||w (f* - f)|| / ||w f||` over all direction pairs and bands.

    Args:
        f: measured values in 1/sr, shape (..., B), bands last.
        f_star: predicted values, same shape.
        weight: w per direction pair, shape (...); `cosine_weight(wi, wo)` in this package's reports.
    Returns:
        0 for a perfect prediction, 1 for one of all zeros; 0 / 0 counts as 0, anything else over 0 as a very large
        finite number: JSON has no infinity.
    Raises:
        ShapeError: the shapes differ.
    """
    return float(_errors_of(f, f_star, weight).relative_error)


def cube_root_error(f: Array, f_star: Array, weight: Array | float = 1.0) -> float:
    """`||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`, as `relative_error`; nearer to what is seen."""
    return float(_errors_of(f, f_star, weight).cube_root_error)


def _errors_of(f: Array, f_star: Array, weight: Array | float) -> RunningErrors:
    """The errors of one material with values (..., B) in 1/sr, weight (...) or one for all."""
    f, f_star = np.asarray(f), np.asarray(f_star)
    _require_alike(f, f_star)
    weight = np.asarray(weight, dtype=np.float64)
    if weight.ndim and weight.shape != f.shape[:-1]:
        raise ShapeError(f"weight has shape {weight.shape}, expected {f.shape[:-1]}, one per direction pair")
    errors, rows = RunningErrors(), (-1, f.shape[-1])
    errors.add(f.reshape(rows), f_star.reshape(rows), np.broadcast_to(weight, f.shape[:-1]).reshape(-1))
    return errors


class RunningErrors:
    """Errors accumulated over blocks of direction pairs, of one material or of many side by side.

    Attributes:
        n_pairs: direction pairs counted.
    """

    def __init__(self) -> None:
        self.n_pairs = 0
        self._squared: Array = np.zeros(())
        self._linear: tuple[Array, Array] = (np.zeros(()), np.zeros(()))
        self._cube_root: tuple[Array, Array] = (np.zeros(()), np.zeros(()))

    def add(self, f: Array, f_star: Array, weight: Array, roots: Array | None = None) -> None:
        """Count a block.

        Args:
            f: measured values in 1/sr, shape (..., P, B); leading axes are materials.
            f_star: predicted values, same shape.
            weight: per direction pair, shape (P,).
            roots: `(w f)^(1/3)` where it is at hand, shape (..., P, B).
        Raises:
            ShapeError: f and f_star differ in shape.
        """
        f, f_star = np.asarray(f), np.asarray(f_star)
        _require_alike(f, f_star)
        self.n_pairs += f.shape[-2]
        per_pair = _squared_norms(np.subtract(f_star, f, dtype=np.float64))  # [..., P]
        self._squared = self._squared + per_pair.sum(axis=-1)
        self._linear = _plus(self._linear, per_pair @ weight**2, _squared_norms(f) @ weight**2)
        if roots is None:
            roots = np.cbrt(weight)[:, None] * np.cbrt(f)
        wrong = np.cbrt(weight)[:, None] * np.cbrt(f_star) - roots
        self._cube_root = _plus(
            self._cube_root, _squared_norms(wrong).sum(axis=-1), _squared_norms(roots).sum(axis=-1)
        )

    def rmse(self, n_pairs: float) -> Array:
        """Eq. 22 of Hikichi & Iwasaki with the sum divided by `n_pairs`, per material."""
        return np.sqrt(self._squared / n_pairs)

    @property
    def relative_error(self) -> Array:
        """`||w (f* - f)|| / ||w f||`, per material."""
        return _norm_ratio(*self._linear)

    @property
    def cube_root_error(self) -> Array:
        """`||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`, per material."""
        return _norm_ratio(*self._cube_root)


def _require_alike(f: Array, f_star: Array) -> None:
    if f.shape != f_star.shape or f.ndim == 0:
        raise ShapeError(f"f has shape {f.shape}, f_star {f_star.shape}, expected the same (..., bands)")


def _squared_norms(f: Array) -> Array:
    """Of the last axis, in double precision."""
    return np.einsum("...b,...b->...", f, f, dtype=np.float64)


def _plus(sums: tuple[Array, Array], wrong: Array, norm: Array) -> tuple[Array, Array]:
    return sums[0] + wrong, sums[1] + norm


def _norm_ratio(squared_error: Array, squared_norm: Array) -> Array:
    return np.sqrt(squared_error / np.maximum(squared_norm, _LEAST_SQUARED_NORM))


def spectral_angle(f: Array, f_star: Array) -> Array:
    """Angle between spectra as vectors, in radians in [0, pi], bands last: (..., B) to (...).

    >>> spectral_angle(np.array([1.0, 0.0]), np.array([0.0, 2.0])).round(6)
    np.float64(1.570796)

    Independent of intensity. Two zero spectra have angle 0, a zero and a non-zero one pi / 2.

    Source: Kruse et al. 1993, in the half-angle form of Kahan, which is exact for small angles.
    """
    f, f_star = np.asarray(f, dtype=np.float64), np.asarray(f_star, dtype=np.float64)
    _require_alike(f, f_star)
    u, v = _unit_or_zero(f), _unit_or_zero(f_star)
    return 2.0 * np.arctan2(np.linalg.norm(u - v, axis=-1), np.linalg.norm(u + v, axis=-1))


def _unit_or_zero(f: Array) -> Array:
    norm = np.linalg.norm(f, axis=-1, keepdims=True)
    return f / np.where(norm > 0, norm, 1.0)


def cosine_weight(wi: Array, wo: Array) -> Array:
    """`cos(theta_i) cos(theta_o)`, 0 below the horizon, shape (...)."""
    return np.maximum(wi[..., 2], 0.0) * np.maximum(wo[..., 2], 0.0)


@dataclass(frozen=True)
class RusinkiewiczGrid:
    """A grid of direction pairs over theta_h and theta_d in [0, 90) and phi_d in [0, 180) degrees.

    Half vectors have azimuth 0, which is enough for isotropic materials; others need `is_turned`.

    Attributes:
        n_theta_h, n_theta_d, n_phi_d: nodes per angle; phi_d runs fastest.
        squared_theta_h: space theta_h by squares, dense around the mirror direction, as MERL files do.
        offset: where in its cell a node lies, from 0 (lower edge) to below 1; 0.5 is the centre.
        is_turned: turn each pair about the normal, by multiples of the golden section of a turn: as many pairs, whose
            half vectors have all azimuths at every theta_h.
    """

    n_theta_h: int = 45
    n_theta_d: int = 23
    n_phi_d: int = 12
    squared_theta_h: bool = True
    offset: float = 0.5
    is_turned: bool = False

    def __post_init__(self) -> None:
        if min(self.n_theta_h, self.n_theta_d, self.n_phi_d) < 1 or not 0.0 <= self.offset < 1.0:
            raise UsageError(f"{self}: expected at least one node per angle and an offset in [0, 1)")

    @classmethod
    def named(cls, name: str) -> RusinkiewiczGrid:
        """`default` (45 x 23 x 12, held-out errors) or `hikichi` (90 x 90 x 180, Hikichi & Iwasaki, eq. 22).

        Raises:
            UsageError: the name is unknown.
        """
        if name not in NAMED_GRIDS:
            raise UsageError(f"no grid is called '{name}', expected one of {', '.join(NAMED_GRIDS)}")
        return NAMED_GRIDS[name]

    def suited_to(self, is_isotropic: bool) -> RusinkiewiczGrid:
        """This grid, turned where not all materials that are compared on it are isotropic."""
        return self if is_isotropic else replace(self, is_turned=True)

    @property
    def n_pairs(self) -> int:
        """Number of direction pairs, those below the horizon included."""
        return self.n_theta_h * self.n_theta_d * self.n_phi_d

    def angles(self, start: int = 0, stop: int | None = None) -> tuple[Array, Array, Array]:
        """`theta_h, theta_d, phi_d` in radians of pairs start to stop, each of shape (stop - start,)."""
        index = np.arange(start, self.n_pairs if stop is None else min(stop, self.n_pairs))
        h, d, p = np.unravel_index(index, (self.n_theta_h, self.n_theta_d, self.n_phi_d))
        fraction_h = (h + self.offset) / self.n_theta_h
        theta_h = (fraction_h**2 if self.squared_theta_h else fraction_h) * (0.5 * np.pi)
        theta_d = (d + self.offset) / self.n_theta_d * (0.5 * np.pi)
        return theta_h, theta_d, (p + self.offset) / self.n_phi_d * np.pi

    def directions(self, start: int = 0, stop: int | None = None) -> tuple[Array, Array, Mask]:
        """Pairs start to stop: wi (M, 3), wo (M, 3), and which lie above the horizon, bool (M,)."""
        wi, wo = from_rusinkiewicz(*self.angles(start, stop))
        above = (wi[:, 2] > 0.0) & (wo[:, 2] > 0.0)
        if self.is_turned:
            azimuth = 2.0 * np.pi * ((_GOLDEN * np.arange(start, start + len(wi))) % 1.0)
            wi, wo = rotate_z(wi, azimuth), rotate_z(wo, azimuth)
        return wi, wo, above

    def blocks(self, size: int = 65536) -> Iterator[tuple[Array, Array, Mask]]:
        """`directions` in blocks of at most `size` pairs: the whole 1,458,000-pair grid in bounded memory."""
        for start in range(0, self.n_pairs, size):
            yield self.directions(start, start + size)


NAMED_GRIDS = {
    "default": RusinkiewiczGrid(),
    "hikichi": RusinkiewiczGrid(90, 90, 180, squared_theta_h=False, offset=0.0),
}
