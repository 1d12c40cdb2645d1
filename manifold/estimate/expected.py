"""Estimates the errors of a completion from completing the library's own materials from the same observations."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.panel import Panel
from manifold.core.defaults import TINY
from manifold.core.directions import is_near_mirror
from manifold.core.metrics import Errors, RunningErrors
from manifold.core.records import Array, Indices, Mask, evenly_spaced
from manifold.core.threads import one_blas_thread, share_out
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import NOISY, Completion
from manifold.estimate.evidence import Evidence, channel_atoms, clipping, nearest_bands
from manifold.estimate.left_out_readings import LeftOutReadings
from manifold.estimate.solving import CONTRADICTION
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.model.expected_error import BELOW_TWICE

CALIBRATION_VERSION = 3
"""Version of stored calibrations; increase it when completions or leave-one-out errors change."""

_KINDS = ("ball", "scaled_ball", "cube_root", "linear", "near_mirror", "elsewhere")  # some may be unknown
_LEFT_OUT = 16  # materials by which errors of estimates from pictures are calibrated
_MARGIN = 1.05  # residuals closer to the largest are equal to it for a user, and by rounding
_PLAUSIBLE, _RESIDUALS = "plausible_", "residuals"  # names of arrays in a library's cache
_WORLD = 20  # left-out materials of a library that count as much as `_OF_WORLD`
_OF_WORLD = {
    "ball": 0.65,
    "scaled_ball": 0.65,
    "cube_root": 1.35,
    "linear": 1.2,
    "near_mirror": 1.4,
    "elsewhere": 0.9,
}
"""Factors of plausible errors in the world: 123 neural fits of RGL and MERL completed from the other 20 of RGL, as
measured, mean over five sets of readings (benchmarks/bench_completion_errors.py)."""

LARGE = 0.26
"""Cube-root error of values that are off by a factor of two."""


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Errors of N materials of a library, each left out and completed from the same observations.

    Attributes:
        errors: true errors of the materials, those of `_KINDS` that are known, each (N,).
        plausible: `plausible_errors` of the materials, each (N,).
        residuals: residuals of the observations, shape (N,).
    """

    errors: Errors[Array]
    plausible: Errors[Array]
    residuals: Array

    @classmethod
    def leave_out(
        cls, method: Callable[[int], tuple[Errors[float], Errors[float], float]], materials: Sequence[int]
    ) -> Calibration:
        """Make a calibration by leaving out each material, in several threads.

        `method` returns the errors, plausible errors and residual of a left-out material.
        """
        found: dict[int, tuple[Errors[float], Errors[float], float]] = {}
        with one_blas_thread:
            share_out(lambda m: found.__setitem__(m, method(m)), materials)
        errors, plausible, residuals = zip(*(found[m] for m in materials), strict=True)
        return cls(_arrays(errors), _arrays(plausible), np.array(residuals))

    def __repr__(self) -> str:
        medians = ", ".join(self.errors.median.words)
        return f"<Calibration: {len(self.residuals)} materials left out, medians: {medians}>"

    def expected(self, completion: Completion, left_out: LeftOutReadings | None = None) -> Errors[float]:
        """Return the expected errors of a completion from these observations.

        They are its plausible errors times factors, see `_factor`. If the residual is larger than the residual of
        every left-out material, the errors grow in proportion to it. If readings and pictures contradict each other,
        the factors come only from left-out materials with residuals as large as a contradiction, if there are any.
        The ball error also includes the uncertainty of colours that were estimated from three bands or that repeated
        readings leave open. No error is smaller than the median error with which the other readings predict each
        reading, if `left_out` is given.
        """
        known = np.full(len(self.residuals), True)
        if completion.solution.contradiction > CONTRADICTION and np.any(self.residuals > CONTRADICTION):
            known = self.residuals > CONTRADICTION
        found = self.at(plausible_errors(completion), completion.residual, known)
        if not completion.is_brightness_guessed:
            found = replace(found, scaled_ball=np.nan)
        found = found.beside(Errors(ball=completion.colour_error))
        return found if left_out is None else found.at_least(left_out.typical)

    def notes(self, completion: Completion) -> tuple[str, ...]:
        """Return a note if the residual exceeds that of every left-out material and what noise can explain."""
        residual, has_pictures = completion.residual, bool(completion.evidence.pictures)
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
        return float(self.residuals.max())

    def is_beyond(self, residual: float) -> bool:
        """Return whether a residual exceeds the residual of every left-out material by more than `_MARGIN`."""
        return residual > _MARGIN * self.largest_residual

    @property
    def expected_of_left_out(self) -> Errors[Array]:
        """Expected errors of every material, estimated from the other materials, each (N,)."""
        every = np.arange(len(self.residuals))
        return Errors.of_several(
            [
                self.at(self.plausible.over(lambda values: float(values[i])), self.residuals[i], every != i)  # noqa: B023
                for i in every
            ]
        )

    def at(self, plausible: Errors[float], residual: float, known: Mask) -> Errors[float]:
        """Return the errors expected from plausible errors and a residual.

        They are estimated from the left-out materials that the mask `known` (N,) selects.
        """
        beyond = max(residual / max(float(self.residuals[known].max()), TINY), 1.0)
        expected = {}
        for kind in self.errors.known:
            ratios = getattr(self.errors, kind)[known] / np.maximum(
                getattr(self.plausible, kind)[known], TINY
            )
            expected[kind] = beyond * _factor(ratios, _OF_WORLD[kind]) * getattr(plausible, kind)
        return Errors(**expected)


def unreliable(expected: Errors[float]) -> str | None:
    """Return where the expected errors are too large to use a completion: "all directions", "highlights", or None."""
    if expected.elsewhere > LARGE:
        return "all directions"
    return "highlights" if expected.near_mirror > LARGE else None


def _arrays(errors: Sequence[Errors[float]]) -> Errors[Array]:
    known = Errors.of_several(errors).known
    return Errors(**{kind: known[kind] for kind in _KINDS if kind in known})


def typical(values: Array) -> float:
    """Return a typical error: the median, or half the 90th percentile if that is larger.

    The percentile is computed with one large value added.
    """
    N = len(values)
    most = float(np.quantile(values, min(BELOW_TWICE * (N + 1) / N, 1.0)))
    return max(float(np.median(values)), most / 2.0)


def _factor(ratios: Array, of_world: float) -> float:
    """Return the factor of plausible errors: the typical ratio (N,) of true errors to them, or a larger one.

    Materials of a kind that the library lacks are not among its left-out materials, so the ratios alone give a factor
    that is too small. The factor `of_world` was measured on neural fits. If it is larger, it counts as `_WORLD` further
    materials. Factors are averaged by their logarithms.
    """
    own = max(typical(ratios), TINY)
    share = _WORLD / (_WORLD + len(ratios))
    return own * max(of_world / own, 1.0) ** share


def plausible_errors(made: Completion) -> Errors[float]:
    """Return the errors of a completion if its true material were another that explains the observations about as well.

    The other materials are the library's materials and the coats, each scaled and mixed with a Lambertian, see
    `mixtures.Alike`; they are not scaled if only the library determines the brightness. The errors are geometric
    means over these materials, averaged over bands or channels; the ball error is the error of lightness.
    """
    atoms, n = made.atoms, made.atoms.n_grid
    lights, pixels, pairs = _some_pixels(panel.judged())
    stars: Array = made.on_grid.T
    lit_stars: Array = made.on_ball[pixels].T if atoms.is_linear else lights.of(made.on_ball[pairs]).T
    if not atoms.is_linear:
        stars, lit_stars = stars.mean(axis=0)[None], lit_stars.mean(axis=0)[None]
    means = []
    for f_star, light_star, hypotheses in zip(stars, lit_stars, made.solution.hypotheses, strict=True):
        alike = hypotheses.alike
        if made.is_brightness_guessed:
            alike = alike.as_bright_as_atoms
        if atoms.is_linear:
            f: Array = alike.of(atoms.on_grid) / atoms.grid.cosines
            light = alike.of(atoms.on_ball[:, pixels])
        else:
            f = alike.of(atoms.directions[:, :n]) ** 3
            light = lights.of(alike.of(atoms.ball[:, pairs]).T ** 3).T
        roots, roots_star = (np.cbrt(np.clip(each, 0.0, 1.0)) for each in (light, light_star))
        errors = _errors_of_values(atoms, f[..., None], np.broadcast_to(f_star[:, None], (*f.shape, 1)))
        errors |= Errors(ball=_lightness(lights, roots - roots_star))
        if atoms.is_linear:
            scale = roots @ roots_star / max(float(roots_star @ roots_star), TINY)
            errors |= Errors(scaled_ball=_lightness(lights, roots - np.outer(scale, roots_star)))
        means.append(errors.over(alike.geometric_mean))
    return _arrays(means).over(lambda of_channels: float(np.exp(np.mean(np.log(of_channels)))))


def _lightness(lights: Panel, differences: Array) -> Array:
    """Return mean differences of L* over the pixels of balls, shape (A,), given differences of cube roots (A, K)."""
    return np.asarray(116.0 * np.average(np.abs(differences), axis=1, weights=lights.pixel_weights))


@lru_cache(maxsize=4)
def _some_pixels(lights: Panel) -> tuple[Panel, Indices, Indices]:
    """Return some pixels of lights, their indices, and the indices of the direction pairs that light them."""
    some, pixels = lights.every(panel.STRIDE)
    return some, pixels, np.unique(lights.sums[pixels].indices)


def calibrate(atoms: LibraryAtoms, seen: Readings | Evidence, library: Library | None = None) -> Calibration:
    """Return the errors of completing every library material from the others, with the same kind of observations.

    If there are pictures, an evenly spaced subset of the materials is used.

    Args:
        atoms: atoms of the library.
        seen: the observations, of which only directions, bands, weights, gloss angles, light, clipping and known
            exposures are used; pictures must be divided by their exposures, see `Completion.exposed`.
        library: library in which the result is cached; None caches nothing.
    """
    evidence = seen if isinstance(seen, Evidence) else Evidence.of_instruments(atoms, seen)
    if library is None:
        return _calibrated(atoms, evidence)
    return cached(library, _cache_key(atoms, evidence, library), lambda: _calibrated(atoms, evidence))


def cached(library: Library, key: str, calibrate: Callable[[], Calibration]) -> Calibration:
    """Return the calibration for a key from the cache of a library; a missing calibration is made and stored.

    A calibration for other test lights counts as missing.
    """
    key = hashlib.sha256(f"{key} {panel.judged().signature}".encode()).hexdigest()
    kept = library.cache_get(key) or {}
    residuals = kept.get(_RESIDUALS, np.empty(0))
    arrays: list[dict[str, Any]] = [
        {kind: kept[prefix + kind] for kind in _KINDS if prefix + kind in kept} for prefix in ("", _PLAUSIBLE)
    ]
    shapes = {values.shape for each in arrays for values in each.values()}
    if shapes == {residuals.shape} == {(len(residuals),)}:
        return Calibration(Errors(**arrays[0]), Errors(**arrays[1]), residuals)
    calibration = calibrate()
    plausible = {_PLAUSIBLE + kind: values for kind, values in calibration.plausible.known.items()}
    library.cache_put(key, {**calibration.errors.known, **plausible, _RESIDUALS: calibration.residuals})
    return calibration


def _cache_key(atoms: LibraryAtoms, evidence: Evidence, library: Library) -> str:
    """Return a hash of all that a calibration depends on: library, version, and observations but for their values.

    Directions and weights of readings are rounded and sorted, so that processors agree on the key.
    """
    axes: tuple[object, ...] = (atoms.names, atoms.coats, atoms.bands.wavelengths_nm, tuple(evidence.gloss))
    arrays: list[Array] = []
    readings = evidence.readings
    if readings is not None and not evidence.pictures:
        is_read = nearest_bands(atoms.band_axis, readings.bands)
        axes += (is_read.tolist(), round(readings.repeatability, 6))
        pairs = np.column_stack([readings.wi, readings.wo, readings.weights])
        pairs = np.round(pairs, 6) + 0.0  # + 0.0: no negative zeros
        arrays.append(pairs[np.lexsort(pairs.T)])
    if evidence.pictures:
        # The words stand for the definition of residuals: calibrations of pictures alone depend on it.
        axes += (evidence.exposure is None, evidence.has_gains, "residual as given")
    for picture in evidence.pictures:
        for rows in picture:
            arrays += [rows.atoms, rows.weights, np.array(clipping(rows))]
    for rows in (*evidence.of_readings, *evidence.of_gloss):
        arrays += [rows.atoms, rows.weights]
    digest = hashlib.sha256(f"completion {CALIBRATION_VERSION} {library.content_hash} {axes}".encode())
    for array in arrays:
        digest.update(array.tobytes())
    return digest.hexdigest()


def _calibrated(atoms: LibraryAtoms, evidence: Evidence) -> Calibration:
    N = len(atoms.names)

    def method(m: int) -> tuple[Errors[float], Errors[float], float]:
        made = leave_out(atoms, m, evidence)
        return errors_of(atoms, m, made.on_grid, made.on_ball), plausible_errors(made), made.residual

    return Calibration.leave_out(
        method, evenly_spaced(N, _LEFT_OUT).tolist() if evidence.pictures else range(N)
    )


def leave_out(atoms: LibraryAtoms, m: int, seen: Readings | Evidence) -> Completion:
    """Complete material m from all others, in the bands of the atoms or the channels of the camera, without noise.

    See `calibrate` for the parts of `seen` that are used.
    """
    evidence = seen if isinstance(seen, Evidence) else Evidence.of_instruments(atoms, seen)
    others = atoms if evidence.pictures else atoms.in_atom_bands()
    return Completion.of(others, evidence.of_material(others, m), usable=atoms.material_of != m)


def errors_of_weights(atoms: LibraryAtoms, m: int, weights: Array) -> Errors[float]:
    """Return the errors of predicting material m with weights (3, n) of atoms of values, in a camera's channels."""
    return errors_of(atoms, m, atoms.grid_values(weights), (weights @ atoms.on_ball).T)


def errors_of(atoms: LibraryAtoms, m: int, on_grid: Array, on_ball: Array) -> Errors[float]:
    """Return the errors of values f predicted for material m, in the bands of the atoms; unknown if f is not finite.

    `on_grid` (P_g, B_s) is f on the grid, `on_ball` (P_b, B_s) f at the direction pairs of a ball in the five test
    lights. If the atoms hold values instead of cube roots (`is_linear`), `on_grid` (P_g, 3) is f in the channels of a
    camera, and `on_ball` (K, 3) holds the pixels of the ball in these channels.
    """
    if not np.all(np.isfinite(on_ball)):
        return Errors()
    lights, n = panel.judged(), atoms.n_grid
    if atoms.is_linear:
        own = channel_atoms(atoms, m)
        ball, scaled = atoms.on_ball[own].T, on_ball * _best_factor(atoms.on_ball[own].T, on_ball)
        xyz, *stars = (srgb_to_xyz(np.clip(pixels, 0.0, 1.0)) for pixels in (ball, on_ball, scaled))
        look, of_scaled = (lights.compare(xyz, star) for star in stars)
        look = replace(look, scaled_ball=of_scaled.ball)
    else:
        own = np.flatnonzero(atoms.material_of == m)
        look = lights.errors(atoms.ball[own].T ** 3, on_ball, atoms.band_axis)
    return look | _errors_of_values(atoms, atoms.directions[own, :n].T ** 3, on_grid).over(float)


def _best_factor(light: Array, made: Array) -> float:
    """Return the factor on pixels `made` (K, 3) that brings their cube roots nearest to those of `light` (K, 3).

    Pixels brighter than white count as white.
    """
    roots, roots_made = (np.cbrt(np.clip(each, 0.0, 1.0)) for each in (light, made))
    return float(np.sum(roots * roots_made) / max(float(np.sum(roots_made**2)), TINY)) ** 3


def _errors_of_values(atoms: LibraryAtoms, f: Array, f_star: Array) -> Errors[Array]:
    """Return errors of values f_star at the grid, near mirror directions and elsewhere too, from f (..., P_g, B)."""
    cosines = atoms.weights[: atoms.n_grid] ** 1.5
    is_near = is_near_mirror(atoms.grid.wi, atoms.grid.wo)

    def within(part: Mask | slice) -> Errors[Array]:
        errors = RunningErrors()
        errors.add(f[..., part, :], f_star[..., part, :], cosines[part])
        return errors.errors()

    every = within(slice(None))
    near, elsewhere = within(is_near).cube_root, within(~is_near).cube_root
    return Errors(cube_root=every.cube_root, linear=every.linear, near_mirror=near, elsewhere=elsewhere)
