"""Expected errors of a completion: those of the library's materials, completed from the same observations."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import nnls

from manifold import __version__
from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.core.metrics import Errors
from manifold.core.records import Array, evenly_spaced
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import NOISY, Completion
from manifold.estimate.evidence import Evidence, channel_atoms, clipping
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.model.expected_error import BELOW_TWICE

_KINDS = ("ball", "cube_root", "linear", "near_mirror", "elsewhere")  # of which some may be unknown
_NEAR_MIRROR_DEG = 10.0  # from the mirror direction
_LEFT_OUT = 16  # materials by which errors of estimates from pictures are calibrated
_MARGIN = 1.05  # residuals closer to the largest are equal to it for a user, and by rounding
_PRIOR = 0.1  # strength of the prior that errors do not depend on an indicator, in units of its variance


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Errors of left-out materials of a library, completed from the same observations.

    Attributes:
        errors: of every material, those of `_KINDS` that are known, each (N,).
        indicators: residual of the observations and spread of mixtures, from which errors are predicted, shape (N, 2).
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
        """Return the expected errors of a completion from these observations.

        Logarithms of errors are linear in those of the indicators, with non-negative slopes. As for predictions, at
        least half of the left-out errors are below the expected one, and 90 % below twice that. Where the residual is
        larger than that of any left-out material, errors grow in proportion to it. The error of colours that were
        estimated from three bands, or that repeated readings leave open, is added to that of the ball.
        """
        return self.at(completion.indicators).beside(Errors(ball=completion.colour_error))

    def at(self, indicators: Array) -> Errors[float]:
        """Return the expected errors for some indicators (2,)."""
        line = self._line(indicators, np.ones(len(self.indicators), bool))
        return Errors(**dict(zip(self._kinds, line.tolist(), strict=True)))

    def notes(self, completion: Completion) -> tuple[str, ...]:
        """Return a note if the residual is larger than that of every left-out material, and than noise makes it."""
        residual, has_pictures = float(completion.indicators[0]), bool(completion.evidence.pictures)
        if not self.is_beyond(residual) or (has_pictures and residual <= NOISY):
            return ()
        what, check = "readings", "they may be of two samples, in other units or directions"
        if has_pictures:
            what, check = (
                "pixels",
                "check the light, its turn and exposure, and the circle; they may be of two materials",
            )
        return (
            f"the residual of the {what} is {100.0 * residual:.3g} %, that of left-out materials at most "
            f"{100.0 * self.largest_residual:.3g} %: {check}, or of a kind of material that the library lacks; errors "
            "may be larger than expected",
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


def calibrate(atoms: LibraryAtoms, seen: Readings | Evidence, library: Library | None = None) -> Calibration:
    """Complete every material of a library from the others, with the same observations.

    Beside pictures some of the materials, evenly chosen, stand for all.

    Args:
        atoms: of the library.
        seen: of which only directions, bands, weights and angles of gloss, light and clipping are used, and what is
            known of the exposures; pictures under these, see `Completion.exposed`.
        library: in whose cache the result is kept for these, and from which it is taken if it is there.
    """
    evidence = seen if isinstance(seen, Evidence) else Evidence.of_instruments(atoms, seen)
    if library is None:
        return _calibrated(atoms, evidence)
    return cached(library, _cache_key(atoms, evidence, library), lambda: _calibrated(atoms, evidence))


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


def _cache_key(atoms: LibraryAtoms, evidence: Evidence, library: Library) -> str:
    """Return a hash of all that a calibration depends on: library, program, and observations but for their values."""
    axes: tuple[object, ...] = (atoms.names, atoms.coats, atoms.bands.wavelengths_nm, tuple(evidence.gloss))
    arrays: list[Array] = []
    readings = evidence.readings
    if readings is not None and not evidence.pictures:
        axes += (readings.bands.wavelengths_nm, readings.repeatability)
        arrays += [readings.wi, readings.wo, readings.weights]
    if evidence.pictures:
        axes += (evidence.exposure is None, evidence.has_gains)
    for picture in evidence.pictures:
        for rows in picture:
            arrays += [rows.atoms, rows.weights, np.array(clipping(rows))]
    for rows in (*evidence.of_readings, *evidence.of_gloss):
        arrays += [rows.atoms, rows.weights]
    digest = hashlib.sha256(f"completion {__version__} {library.content_hash} {axes}".encode())
    for array in arrays:
        digest.update(array.tobytes())
    return digest.hexdigest()


def _calibrated(atoms: LibraryAtoms, evidence: Evidence) -> Calibration:
    N = len(atoms.names)

    def method(m: int) -> tuple[Errors[float], Array]:
        made = leave_out(atoms, m, evidence)
        return errors_of(atoms, m, made.on_grid, made.on_ball), made.indicators

    return Calibration.leave_out(
        method, evenly_spaced(N, _LEFT_OUT).tolist() if evidence.pictures else range(N)
    )


def leave_out(atoms: LibraryAtoms, m: int, seen: Readings | Evidence) -> Completion:
    """Complete material m from all others, in the bands of the atoms or the channels of the camera, without noise.

    `calibrate` says which parts of the observations count.
    """
    evidence = seen if isinstance(seen, Evidence) else Evidence.of_instruments(atoms, seen)
    others = atoms if evidence.pictures else atoms.in_atom_bands()
    return Completion.of(others, evidence.of_material(others, m), usable=atoms.material_of != m)


def errors_of_weights(atoms: LibraryAtoms, m: int, weights: Array) -> Errors[float]:
    """Return errors of weights (3, n) of atoms of values, in the channels of a camera, for material m."""
    return errors_of(atoms, m, atoms.grid_values(weights), (weights @ atoms.on_ball).T)


def errors_of(atoms: LibraryAtoms, m: int, on_grid: Array, on_ball: Array) -> Errors[float]:
    """Return errors of f predicted for material m in the bands of the atoms; unknown if f is not finite.

    f is predicted on the grid, shape (P_g, B_s), and at the pairs that light a ball in the judged lights, (P_b, B_s);
    for atoms of values in the channels of a camera: on the grid, (P_g, 3), and in the pixels of the ball, (K, 3).
    """
    if not np.all(np.isfinite(on_ball)):
        return Errors()
    lights, n = panel.judged(), atoms.n_grid
    if atoms.is_linear:
        own = channel_atoms(atoms, m)
        balls = (srgb_to_xyz(np.clip(pixels, 0.0, 1.0)) for pixels in (atoms.on_ball[own].T, on_ball))
        look = lights.compare(*balls)
    else:
        own = np.flatnonzero(atoms.material_of == m)
        look = lights.errors(atoms.ball[own].T ** 3, on_ball, atoms.band_axis)
    truth, cosines = atoms.directions[own, :n].T ** 3, atoms.weights[:n] ** 1.5
    wi, wo = atoms.grid.wi, atoms.grid.wo
    is_near = np.sum(wi * wo * [-1.0, -1.0, 1.0], axis=1) > np.cos(np.deg2rad(_NEAR_MIRROR_DEG))
    near, elsewhere = (
        Errors.of_values(truth[part], on_grid[part], cosines[part]).cube_root for part in (is_near, ~is_near)
    )
    return replace(look | Errors.of_values(truth, on_grid, cosines), near_mirror=near, elsewhere=elsewhere)
