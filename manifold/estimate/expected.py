"""Expected errors of a completion: those of the library's materials, completed from the same directions."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import nnls

from manifold import __version__
from manifold.colour import panel
from manifold.colour.conversion import luminance
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import Completion
from manifold.estimate.gloss import value_of_unit
from manifold.formats.readings import MOST_GLOSS, Readings
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.model.expected_error import BELOW_TWICE
from manifold.records import Array, Bands, Mask

_KINDS = ("ball", "cube_root", "linear", "near_mirror", "elsewhere")  # of which some may be unknown
_NEAR_MIRROR_DEG = 10.0  # from the mirror direction
_MARGIN = 1.05  # residuals closer to the largest are equal to it for a user, and by rounding
_PRIOR = 0.1  # strength of the prior that errors do not depend on an indicator, in units of its variance


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Errors of left-out materials of a library, completed from the directions of some readings.

    Attributes:
        errors: of every material, those of `_KINDS` that are known, each (N,).
        indicators: residual of the readings and spread of hypotheses, from which errors are predicted, shape (N, 2).
    """

    errors: Errors[Array]
    indicators: Array

    @classmethod
    def leave_out(
        cls, method: Callable[[int], tuple[Errors[float], Array]], materials: Iterable[int]
    ) -> Calibration:
        """Make a calibration from errors and indicators (2,) that a method finds for left-out materials."""
        errors, indicators = zip(*map(method, materials), strict=True)
        known = Errors.of_several(errors).known
        return cls(Errors(**{kind: known[kind] for kind in _KINDS if kind in known}), np.array(indicators))

    def __repr__(self) -> str:
        medians = ", ".join(self.errors.median.words)
        return f"<Calibration: {len(self.indicators)} materials left out, medians: {medians}>"

    def expected(self, completion: Completion) -> Errors[float]:
        """Return the expected errors of a completion from these directions.

        Logarithms of errors are linear in those of the indicators, with non-negative slopes. As for predictions, at
        least half of the left-out errors are below the expected one, and 90 % below twice that. Where the residual is
        larger than that of any left-out material, errors grow in proportion to it. The error of colours that were
        estimated from three bands, or that repeated readings leave open, is added to that of the ball.
        """
        return self.at(indicators_of(completion)).beside(Errors(ball=completion.colour_error))

    def at(self, indicators: Array) -> Errors[float]:
        """Return the expected errors for some indicators (2,)."""
        line = self._line(indicators, np.ones(len(self.indicators), bool))
        return Errors(**dict(zip(self._kinds, line.tolist(), strict=True)))

    def notes(self, completion: Completion) -> tuple[str, ...]:
        """Return a note if the residual of the readings is larger than that of every left-out material."""
        residual = float(indicators_of(completion)[0])
        if not self.is_beyond(residual):
            return ()
        return (
            f"the residual of the readings is {100.0 * residual:.3g} %, that of left-out materials at most "
            f"{100.0 * self.largest_residual:.3g} %: they may be of two samples, in other units or directions, or of a "
            "kind of material that the library lacks; errors may be larger than expected",
        )

    @property
    def largest_residual(self) -> float:
        """The largest residual of a left-out material."""
        return float(self.indicators[:, 0].max())

    def is_beyond(self, residual: float) -> bool:
        """Return whether a residual is larger than that of every left-out material, by more than `_MARGIN`."""
        return residual > _MARGIN * self.largest_residual

    @property
    def left_out(self) -> Errors[Array]:
        """Expected errors of every material, learned from the others, each (N,)."""
        every = np.arange(len(self.indicators))
        lines = np.array([self._line(self.indicators[i], every != i) for i in every])
        return Errors(**dict(zip(self._kinds, lines.T, strict=True)))

    @property
    def _kinds(self) -> list[str]:
        return [kind for kind in _KINDS if kind in self.errors.known]

    @property
    def _table(self) -> Array:
        return np.column_stack([getattr(self.errors, kind) for kind in self._kinds])

    def _line(self, indicators: Array, known: Array) -> Array:
        """Return expected errors of the known kinds at indicators (2,), from some materials (N,)."""
        x, y = (np.log(np.maximum(a[known], 1e-6)) for a in (self.indicators, self._table))
        centre, level = x.mean(axis=0), y.mean(axis=0)
        scale = x.std(axis=0) + 1e-6
        X = np.vstack([(x - centre) / scale, np.sqrt(_PRIOR * len(x)) * np.eye(x.shape[1])])
        log = np.log(np.maximum(indicators, 1e-6))
        at = (np.clip(log, x.min(axis=0), x.max(axis=0)) - centre) / scale
        beyond = max(log[0] - x[:, 0].max(), 0.0)
        slopes = np.array([nnls(X, np.append(column, np.zeros(x.shape[1])))[0] for column in (y - level).T])
        above = y - level - X[: len(x)] @ slopes.T
        enough = np.quantile(above, BELOW_TWICE, axis=0) - np.log(2.0)
        return np.asarray(np.exp(level + slopes @ at + beyond + np.maximum(np.median(above, axis=0), enough)))


def indicators_of(completion: Completion) -> Array:
    """Return the indicators of its error, shape (2,): residual of readings, spread of hypotheses.

    The residual is that of the completion, root mean square, or of the mixtures that it was made from if they differ
    more from what was read.
    """
    return np.array(
        [max(completion.residual_of_readings, completion.residual_of_mixtures), completion.spread]
    )


def calibrate(atoms: LibraryAtoms, readings: Readings, library: Library | None = None) -> Calibration:
    """Complete every material of a library from the others, at the directions and in the bands of some readings.

    Args:
        atoms: of the library.
        readings: of which only directions, bands, weights and angles of gloss are used.
        library: in whose cache the result is kept for these, and from which it is taken if it is there.
    """
    if library is None:
        return _calibrated(atoms, readings)
    return cached(library, _cache_key(atoms, readings, library), lambda: _calibrated(atoms, readings))


def cached(library: Library, key: str, calibrate: Callable[[], Calibration]) -> Calibration:
    """Return the calibration of a key in the cache of a library; a missing one is made and stored there.

    One that was made in other judged lights counts as missing.
    """
    key = hashlib.sha256(f"{key} {panel.judged().signature}".encode()).hexdigest()
    kept = library.cache_get(key) or {}
    indicators = kept.get("indicators", np.empty(0))
    errors = {kind: kept[kind] for kind in _KINDS if kind in kept}
    if (
        errors
        and all(array.shape == (len(indicators),) for array in errors.values())
        and indicators.shape[1:] == (2,)
    ):
        return Calibration(Errors(**cast(dict[str, Any], errors)), indicators)
    calibration = calibrate()
    library.cache_put(key, {**calibration.errors.known, "indicators": calibration.indicators})
    return calibration


def _cache_key(atoms: LibraryAtoms, readings: Readings, library: Library) -> str:
    """Return a hash of all that a calibration depends on: library, geometry and bands of the instrument, program."""
    axes = (
        atoms.names,
        atoms.coats,
        atoms.bands.wavelengths_nm,
        readings.bands.wavelengths_nm,
        tuple(readings.gloss),
        readings.repeatability,
    )
    digest = hashlib.sha256(
        f"completion in lights and regions {__version__} {library.content_hash} {axes}".encode()
    )
    for array in (readings.wi, readings.wo, readings.weights):
        digest.update(array.tobytes())
    return digest.hexdigest()


def _calibrated(atoms: LibraryAtoms, readings: Readings) -> Calibration:
    at_readings, at_gloss = atoms.at(readings.wi, readings.wo), atoms.gloss(tuple(readings.gloss))

    def method(m: int) -> tuple[Errors[float], Array]:
        completion = leave_out(atoms, m, at_readings, readings, at_gloss)
        return errors_of(atoms, m, completion.on_grid, completion.on_ball), indicators_of(completion)

    return Calibration.leave_out(method, range(len(atoms.names)))


def leave_out(
    atoms: LibraryAtoms, m: int, at_readings: Array, readings: Readings, at_gloss: Array | None = None
) -> Completion:
    """Complete material m from all others in the bands of the atoms, from readings without noise.

    It is read in those of these bands that are nearest to the readings' only, so that errors of extrapolation to other
    bands count. Cube roots of atoms at the readings have shape (n + 1, P), at their gloss (n + 1, G); of the readings,
    directions, bands, weights and angles of gloss are used.
    """
    own, axis = atoms.material_of == m, atoms.band_axis
    glossy = np.empty((len(own), 0)) if at_gloss is None else at_gloss
    is_read = _nearest(axis, readings.bands)
    gloss = {
        angle: min(float(mean) / value_of_unit(angle), MOST_GLOSS[angle])
        for angle, mean in zip(readings.gloss, luminance(glossy[own].T ** 3, axis), strict=True)
    }
    read = Readings(
        atoms.names[m], "library", readings.wi, readings.wo,
        None if axis.wavelengths_nm is None else np.array(axis.wavelengths_nm)[is_read],
        at_readings[own].T[:, is_read] ** 3, readings.weights, gloss=gloss, repeatability=readings.repeatability,
    )  # fmt: skip
    return Completion.of(atoms.without(m).in_atom_bands(), read, (at_readings[~own], glossy[~own]))


def _nearest(bands: Bands, to: Bands) -> Mask:
    """Return a mask of the bands (B,) that are nearest to one of others; all if either is linear sRGB."""
    if bands.wavelengths_nm is None or to.wavelengths_nm is None:
        return np.ones(bands.count, bool)
    apart = np.abs(np.subtract.outer(to.wavelengths_nm, bands.wavelengths_nm))
    return np.isin(np.arange(bands.count), apart.argmin(axis=1))


def errors_of(atoms: LibraryAtoms, m: int, on_grid: Array, on_ball: Array) -> Errors[float]:
    """Return errors of f predicted for material m in the bands of the atoms; unknown if f is not finite.

    f is predicted on the grid, shape (P_g, B_s), and at the pairs that light a ball in the judged lights, (P_b, B_s).
    """
    if not np.all(np.isfinite(on_ball)):
        return Errors()
    own, n = atoms.material_of == m, atoms.n_grid
    truth, cosines = atoms.directions[own, :n].T ** 3, atoms.weights[:n] ** 1.5
    look = panel.judged().errors(atoms.ball[own].T ** 3, on_ball, atoms.band_axis)
    wi, wo = atoms.grid.wi, atoms.grid.wo
    is_near = np.sum(wi * wo * [-1.0, -1.0, 1.0], axis=1) > np.cos(np.deg2rad(_NEAR_MIRROR_DEG))
    near, elsewhere = (
        Errors.of_values(truth[part], on_grid[part], cosines[part]).cube_root for part in (is_near, ~is_near)
    )
    return replace(look | Errors.of_values(truth, on_grid, cosines), near_mirror=near, elsewhere=elsewhere)
