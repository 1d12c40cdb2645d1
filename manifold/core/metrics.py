"""Computes errors between BRDFs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

from manifold.core.directions import NEAR_MIRROR_DEG
from manifold.core.errors import ShapeError
from manifold.core.judged_lights import BALL, BALL_COLUMN, LIGHTS, light_in_words
from manifold.core.names import percent
from manifold.core.records import Array, plain

_LEAST_SQUARED_NORM = 1e-200  # smallest squared norm of values that counts as non-black
_UNKNOWN: Any = float("nan")

EXPECTED_BALL = f"expected {BALL_COLUMN}"
ERROR_COLUMNS = {BALL_COLUMN: ("ball",), "cube root": ("cube_root",), "linear": ("linear",)}
"""Columns of the table of a batch that show errors, see `results.Entry`."""
EXPECTED_COLUMNS = {f"expected {title}": keys for title, keys in ERROR_COLUMNS.items()}
"""Columns of the table of a batch that show expected errors."""

Number = TypeVar("Number", bound=float | Array)


@dataclass(frozen=True)
class Errors(Generic[Number]):
    """Errors of BRDFs against a reference: numbers for one BRDF, arrays of any shape for several; NaN if unknown.

    Attributes:
        ball: ball error: mean CIEDE2000 over the ball (a rendered sphere) and five test lights, see `colour.panel`.
        cube_root: `||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`, where w is the product of both cosines.
        linear: `||w (f* - f)|| / ||w f||`.
        worst, worst_light: mean CIEDE2000 over the ball in the light where it is largest; the light's name (of one
            BRDF).
        ball_itp: mean Delta E_ITP (ITU-R BT.2124) over the ball and the five test lights.
        fitted_ball: mean CIEDE2000 over the ball and the lights used for fitting.
        rmse: eq. 22 of Hikichi & Iwasaki, in 1/sr; bands are summed.
        rmse_80: like `rmse`, over directions within 80 degrees of the normal, weighted by both cosines.
        near_mirror: cube-root error of directions within `NEAR_MIRROR_DEG` of the mirror direction.
        elsewhere: cube-root error of all other directions.
        scaled_ball: ball error after multiplying f* by the factor that fits best.
        lights: mean CIEDE2000 over the ball, by light.
        colours: CIEDE2000 by illuminant, averaged over six directions of a multi-angle instrument.
        angles_deg: spectral angle by illuminant, averaged over the same directions.
    """

    ball: Number = _UNKNOWN
    cube_root: Number = _UNKNOWN
    linear: Number = _UNKNOWN
    worst: Number = _UNKNOWN
    worst_light: str = ""
    ball_itp: Number = _UNKNOWN
    fitted_ball: Number = _UNKNOWN
    rmse: Number = _UNKNOWN
    rmse_80: Number = _UNKNOWN
    near_mirror: Number = _UNKNOWN
    elsewhere: Number = _UNKNOWN
    scaled_ball: Number = _UNKNOWN
    lights: Mapping[str, Number] = field(default_factory=dict)
    colours: Mapping[str, Number] = field(default_factory=dict)
    angles_deg: Mapping[str, Number] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Errors({', '.join(f'{name}={value!r}' for name, value in self.known.items())})"

    @classmethod
    def of_values(cls, f: Array, f_star: Array, weight: Array | float = 1.0) -> Errors[float]:
        """Return the cube-root and linear errors of f_star (..., B) against f (..., B), with weights (...) or one."""
        found = _errors_of(f, f_star, weight)
        return Errors(cube_root=float(found.cube_root), linear=float(found.linear))

    @classmethod
    def of_lights(cls, lights: Mapping[str, float], ball_itp: float) -> Errors[float]:
        """Return the ball errors, from CIEDE2000 in every light."""
        worst = max(lights, key=lights.__getitem__)
        return Errors(
            sum(lights.values()) / len(lights), worst=lights[worst], worst_light=worst, ball_itp=ball_itp,
            lights=lights,
        )  # fmt: skip

    @classmethod
    def of_several(cls, each: Sequence[Errors[float]]) -> Errors[Array]:
        """Return the errors of N BRDFs as arrays (N,)."""

        def joined(values: list[Any]) -> Any:
            if isinstance(values[0], Mapping):
                keys = dict.fromkeys(key for value in values for key in value)
                return {key: np.array([value.get(key, np.nan) for value in values]) for key in keys}
            return np.array(values)

        names = dict.fromkeys(name for errors in each for name in errors.known if name != "worst_light")
        return Errors(**{name: joined([getattr(errors, name) for errors in each]) for name in names})

    @property
    def known(self) -> dict[str, Any]:
        """Return the measured errors by name; arrays keep NaN where a BRDF has no value."""

        def is_known(value: Any) -> bool:
            return (
                bool(value) if isinstance(value, str | Mapping) else np.ndim(value) > 0 or not np.isnan(value)
            )

        return {name: value for name, value in vars(self).items() if is_known(value)}

    def __or__(self, other: Errors[Number]) -> Errors[Number]:
        """Return the errors of both; the other's replace these."""
        return replace(self, **other.known)

    def beside(self, other: Errors[float]) -> Errors[Number]:
        """Combine ball, cube-root and linear errors with independent ones, as roots of the sums of squares."""
        both = {
            name for name in ("ball", "cube_root", "linear") if name in self.known and name in other.known
        }
        return replace(self, **{name: np.hypot(getattr(self, name), getattr(other, name)) for name in both})

    def at_least(self, other: Errors[float]) -> Errors[Number]:
        """Return the larger value of each error that is known in both; the other errors stay as they are."""
        both = self.known.keys() & other.known.keys()
        return replace(self, **{name: max(getattr(self, name), getattr(other, name)) for name in both})

    def over(self, of: Callable[[Array], float]) -> Errors[float]:
        """Reduce every array to one number by a function, such as its mean."""

        def one(value: Any) -> Any:
            return {key: of(v) for key, v in value.items()} if isinstance(value, Mapping) else of(value)

        return Errors(**{name: one(value) for name, value in self.known.items()})

    @property
    def median(self) -> Errors[float]:
        """Medians over several BRDFs, without NaN."""
        return self.over(lambda values: float(np.nanmedian(values)))

    @property
    def p90(self) -> Errors[float]:
        """90th percentiles over several BRDFs, without NaN."""
        return self.over(lambda values: float(np.nanpercentile(values, 90)))

    def to_json(self) -> dict[str, Any]:
        """Return the measured errors as plain values."""
        return plain(self.known)

    @property
    def of_each(self) -> dict[str, Any]:
        """Return all errors, medians and 90th percentiles as plain values."""
        return {"errors": self.to_json(), "median": self.median.to_json(), "p90": self.p90.to_json()}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Errors[Array]:
        """Return the errors of several BRDFs from the content that `to_json` wrote."""

        def array(value: Any) -> Any:  # None is NaN
            if isinstance(value, Mapping):
                return {k: np.array(v, np.float64) for k, v in value.items()}
            return np.array(value, np.float64)

        return Errors(**{name: array(value) for name, value in content.items()})

    def __str__(self) -> str:
        worst = f", worst {self.worst:.2f} ({light_in_words(self.worst_light)})" if self.worst_light else ""
        seen = f"; in the lights of the fit {self.fitted_ball:.2f}" if "fitted_ball" in self.known else ""
        return f"{self.ball:.2f} (mean of {LIGHTS}){worst}{seen}"

    @property
    def words(self) -> list[str]:
        """Return texts with the errors of one BRDF, for a terminal."""
        parts = {
            "near_mirror": f"{percent(self.near_mirror)} within {NEAR_MIRROR_DEG:g} degrees of the mirror direction",
            "elsewhere": f"{percent(self.elsewhere)} elsewhere",
        }
        of_parts = ", ".join(words for name, words in parts.items() if name in self.known)
        of_all = {
            "scaled_ball": f"{self.scaled_ball:.1f} {BALL}, after matching the brightness",
            "ball": f"{self.ball:.1f} {BALL}",
            "worst": f"{self.worst:.1f} in the worst light ({light_in_words(self.worst_light)})",
            "cube_root": f"{percent(self.cube_root)} cube-root error"
            + (f" ({of_parts})" if of_parts else ""),
            "linear": f"{percent(self.linear)} linear error",
        }
        if self.linear > 1.0:  # sharp highlights rule it: a percentage says nothing then
            del of_all["linear"]
        return [words for name, words in of_all.items() if name in self.known]


def rmse(f: Array, f_star: Array, *, n_pairs: float | None = None) -> float:
    """Return the root of the squared error, summed over bands and divided by the number of direction pairs only.

    `sqrt(sum_d (f_d - f*_d)^2 / n_pairs)`: bands are summed, not averaged.

    Args:
        f: measured values in 1/sr, shape (..., B), bands last.
        f_star: predicted values, same shape.
        n_pairs: number of direction pairs by which to divide; None divides by the number of pairs in f. Give the size
            of the whole grid if pairs below the horizon (error 0) were left out.

    Raises:
        ShapeError: the shapes differ.
    Source: Hikichi & Iwasaki, eq. 22.

    >>> rmse(np.array([[3.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 4.0], [0.0, 0.0]])).__round__(6)
    3.535534
    """
    return float(_errors_of(f, f_star, 1.0, n_pairs).rmse)


def relative_error(f: Array, f_star: Array, weight: Array | float = 1.0) -> float:
    """Return `||w (f* - f)|| / ||w f||` over all direction pairs and bands.

    Args:
        f: measured values in 1/sr, shape (..., B), bands last.
        f_star: predicted values, same shape.
        weight: weight w of each direction pair, shape (...); this package's reports use `cosine_weight(wi, wo)`.

    Returns:
        0 for a perfect prediction, 1 for a prediction of zeros. 0 / 0 gives 0; any other error over 0 gives a very
        large finite number, because JSON has no infinity.

    Raises:
        ShapeError: the shapes differ.
    """
    return float(_errors_of(f, f_star, weight).linear)


def cube_root_error(f: Array, f_star: Array, weight: Array | float = 1.0) -> float:
    """Return `||(w f*)^(1/3) - (w f)^(1/3)|| / ||(w f)^(1/3)||`.

    Highlights have less weight than in the linear error. Shapes: f and f_star (..., B), weight w (...) or a scalar.
    """
    return float(_errors_of(f, f_star, weight).cube_root)


def _errors_of(f: Array, f_star: Array, weight: Array | float, n_pairs: float | None = None) -> Errors[Array]:
    """Return the errors of one material from values (..., B) in 1/sr and weights (...) or a scalar."""
    f, f_star = np.asarray(f), np.asarray(f_star)
    _require_alike(f, f_star)
    weight = np.asarray(weight, dtype=np.float64)
    if weight.ndim and weight.shape != f.shape[:-1]:
        raise ShapeError(f"weight has shape {weight.shape}, expected {f.shape[:-1]}, one per direction pair")
    errors, rows = RunningErrors(), (-1, f.shape[-1])
    errors.add(f.reshape(rows), f_star.reshape(rows), np.broadcast_to(weight, f.shape[:-1]).reshape(-1))
    return errors.errors(n_pairs)


class RunningErrors:
    """Errors accumulated over blocks of direction pairs, of one material or of many side by side.

    Attributes:
        n_pairs: number of direction pairs so far.
    """

    def __init__(self) -> None:
        self.n_pairs = 0
        self._squared: Array = np.zeros(())
        self._linear: tuple[Array, Array] = (np.zeros(()), np.zeros(()))
        self._cube_root: tuple[Array, Array] = (np.zeros(()), np.zeros(()))

    def add(self, f: Array, f_star: Array, weight: Array, roots: Array | None = None) -> None:
        """Add a block of direction pairs.

        Args:
            f: measured values in 1/sr, shape (..., P, B); leading axes are materials.
            f_star: predicted values, same shape.
            weight: weight of each direction pair, shape (P,).
            roots: `(w f)^(1/3)`, shape (..., P, B), if it is already computed.

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

    def errors(self, n_pairs: float | None = None) -> Errors[Array]:
        """Return cube-root error, linear error and eq. 22 per material.

        `n_pairs` divides the sum of eq. 22; None means the number of pairs that were added.
        """
        return Errors(
            cube_root=_norm_ratio(*self._cube_root), linear=_norm_ratio(*self._linear),
            rmse=np.sqrt(self._squared / (max(self.n_pairs, 1) if n_pairs is None else n_pairs)),
        )  # fmt: skip


def _require_alike(f: Array, f_star: Array) -> None:
    if f.shape != f_star.shape or f.ndim == 0:
        raise ShapeError(f"f has shape {f.shape}, f_star {f_star.shape}, expected the same (..., bands)")


def _squared_norms(f: Array) -> Array:
    """Return squared norms along the last axis, in double precision."""
    return np.einsum("...b,...b->...", f, f, dtype=np.float64)


def _plus(sums: tuple[Array, Array], wrong: Array, norm: Array) -> tuple[Array, Array]:
    return sums[0] + wrong, sums[1] + norm


def _norm_ratio(squared_error: Array, squared_norm: Array) -> Array:
    return np.sqrt(squared_error / np.maximum(squared_norm, _LEAST_SQUARED_NORM))


def spectral_angle(f: Array, f_star: Array) -> Array:
    """Return the angle between spectra as vectors, in radians in [0, pi], bands last: (..., B) to (...).

    >>> spectral_angle(np.array([1.0, 0.0]), np.array([0.0, 2.0])).round(6)
    np.float64(1.570796)

    The angle does not depend on intensity. It is 0 for two zero spectra, and pi / 2 if only one spectrum is zero.

    Source: Kruse et al. 1993, in the half-angle form of Kahan, which is exact for small angles.
    """
    f, f_star = np.asarray(f, dtype=np.float64), np.asarray(f_star, dtype=np.float64)
    _require_alike(f, f_star)
    u, v = _unit_or_zero(f), _unit_or_zero(f_star)
    return 2.0 * np.arctan2(np.linalg.norm(u - v, axis=-1), np.linalg.norm(u + v, axis=-1))


def _unit_or_zero(f: Array) -> Array:
    norm = np.linalg.norm(f, axis=-1, keepdims=True)
    return f / np.where(norm > 0, norm, 1.0)
