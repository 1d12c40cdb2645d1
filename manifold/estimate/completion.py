"""The completion of a material from observations: its BRDF, composition and uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.core.directions import angles_from_mirror, cos_from_mirror
from manifold.core.metrics import Errors
from manifold.core.names import percent
from manifold.core.records import Array, Bands, Mask
from manifold.estimate.atoms import LibraryAtoms, ball_coordinates, grid_coordinates, shown_shares
from manifold.estimate.channels import Channels
from manifold.estimate.evidence import Evidence, bands_of, beyond, in_all_bands
from manifold.estimate.gloss import gloss_differences, gloss_units
from manifold.estimate.mixtures import GlossReadings
from manifold.estimate.residual import DARK, AdjustedBRDF, ResidualFactors, coordinates
from manifold.estimate.solving import (
    CONTRADICTION,
    Seen,
    Solution,
    gather,
    geometric_mean,
    mean_roots,
    ratio_of,
    relative,
    residuals_of,
    solve,
    solve_pictures,
)
from manifold.formats.readings import DAYLIGHT, GLOSS_ANGLES_DEG, Assumption, Readings, Viewing

_SHOWN_ALTERNATIVES = 5
_NEAR_MIRROR_DEG = 5.0  # from a mirror direction, where readings measure all but the sharpest highlights
_GLOSS_MISSED = 0.1  # relative error of cube roots above which gloss is not met
_UNEXPLAINED = 0.2  # residual of mixtures
NOISY = 0.03
"""Residual that noise of photographs can cause."""

_MUCH_DARKER = 4.0  # ratio of f; black materials of the library are within a factor of three of each other
_MUCH_LESS = 0.7  # share of a residual
_VISIBLE_NM = 550.0  # bands on both sides make a colour
_ALIKE = 0.1  # relative difference on a ball below which two mixtures are one alternative
_WITHIN = 0.9  # probability that f is within the factors of `Completion.factors_at`
_LEAST_F = 1e-6  # 1/sr; smaller values count as this


@dataclass(frozen=True)
class Alternative:
    """A mixture of materials that explains the observations.

    Attributes:
        like: names and weights of its materials.
        probability: posterior probability of this mixture and of all mixtures that look like it.
        misfit: relative error at the readings (mean over bands) or of the pixels, before the mixture is adjusted to
            them; root mean square over this mixture and those that look like it.
        difference: relative difference of cube roots on the ball from the mean of all mixtures.
    """

    like: tuple[tuple[str, float], ...]
    probability: float
    misfit: float
    difference: float


@dataclass(frozen=True, eq=False, repr=False)
class Completion:
    """The completion of a material from readings, gloss and pictures, with the materials of a library as prior.

    Attributes:
        atoms: atoms of the library; they combine values if there are pictures.
        evidence: the observations.
        solution: weights of the atoms that explain the observations, in the bands of the readings or the channels of
            the camera.
        written: BRDF of the written file, to which the errors refer; None if they refer to the completion itself.
        expected: expected errors, from `complete_readings`; None from `of`, see `calibrate`.
    """

    atoms: LibraryAtoms
    evidence: Evidence
    solution: Solution
    written: BRDF | None = None
    expected: Errors[float] | None = None

    @classmethod
    def of(
        cls,
        atoms: LibraryAtoms,
        seen: Readings | Evidence | Sequence[Seen],
        *,
        exposure: float | None = 1.0,
        each: bool = False,
        channels: Channels | None = None,
        usable: Mask | None = None,
    ) -> Completion:
        """Complete the observations of a material to a BRDF for all directions.

        Args:
            atoms: atoms of the library, which combine values if there are pictures.
            seen: readings; or a list of pictures by one camera, readings, and gloss by angle; or an `Evidence`.
            exposure: exposure of the pictures relative to the light; None estimates the exposure that is most
                probable given the library's materials and the other observations.
            each: whether every picture has its own exposure, which varies about the common one.
            channels: channels of the camera, if there are pictures; None means linear sRGB.
            usable: mask of the atoms that may be used, shape (n,); None uses all.

        Raises:
            BandMismatchError: the bands of the readings and the library cannot be combined.
            UsageError: there are neither readings nor pictures, no reading can be used, or all readings are zero.
        """
        if not isinstance(seen, Evidence):
            seen = [seen] if isinstance(seen, Readings) else seen
            seen = gather(atoms, seen, exposure=exposure, each=each, channels=channels)
        solution = solve(atoms, seen, usable)
        return cls(atoms, solution.evidence, solution)

    def as_written(self, brdf: BRDF) -> Completion:
        """Return the completion with its errors referring to a written file, given the file's BRDF."""
        written = replace(self, written=brdf)
        if "without" in vars(self):  # solutions do not depend on the file
            vars(written)["without"] = self.without
        return written

    def __repr__(self) -> str:
        like = ", ".join(f"{weight:.2f} {name}" for name, weight in self.made_of)
        return f"<Completion: {self.evidence}, {like}>"

    @property
    def readings(self) -> Readings:
        """The readings, in the bands in which they were compared or, if there are pictures, in their own bands."""
        assert self.evidence.readings is not None, "the material was completed without readings"
        return self.evidence.readings

    @property
    def bands(self) -> Bands:
        """The bands of the completion: those of the library, or those of spectra that an RGB library completes."""
        readings = self.evidence.readings
        return self.atoms.bands if readings is None else bands_of(readings, self.atoms.bands)

    @cached_property
    def weights(self) -> Array:
        """Weights of atoms in all bands, shape (B, n)."""
        if self.evidence.to_bands is not None:
            return np.asarray(self.evidence.to_bands @ self.solution.weights)
        return in_all_bands(self.solution.weights, self.readings, self.atoms.bands)

    @cached_property
    def factors(self) -> ResidualFactors | None:
        """Factors that correct cube roots near the readings, in all bands; None if there are pictures."""
        factors = self.solution.factors
        if factors is None:
            return None
        return replace(factors, strength=in_all_bands(factors.strength, self.readings, self.atoms.bands))

    @cached_property
    def brdf(self) -> BRDF:
        """The completed BRDF.

        If it comes from pictures, spectral bands of saturated colours may be slightly negative.
        """
        combined = self.atoms.predicted(self.weights, self.bands)
        return combined if self.factors is None else AdjustedBRDF(combined, self.factors)

    @cached_property
    def on_grid(self) -> Array:
        """Values f at the encoding grid, shape (P_g, B); if there are pictures, B is the camera's channels."""
        if self.atoms.is_linear:
            return self.atoms.grid_values(self.solution.weights)
        return self._at(self.atoms.directions[:, : self.atoms.n_grid], grid_coordinates())

    @cached_property
    def on_ball(self) -> Array:
        """Values f at all direction pairs of a ball, shape (P_b, B).

        If there are pictures, they are the ball's pixels (K, 3) instead.
        """
        if self.atoms.is_linear:
            return (self.solution.weights @ self.atoms.on_ball).T
        return self._at(self.atoms.ball, ball_coordinates())

    def _at(self, roots: Array, where: Array) -> Array:
        """Return f at coordinates (P, 3), given the atoms' cube roots there, (n + 1, P)."""
        assert self.factors is not None
        return np.asarray((self.weights @ roots * self.factors.at(where)).T ** 3)

    # -- what was read ------------------------------------------------------------------------------------------------

    @cached_property
    def predicted(self) -> Array:
        """Values f of the completion, or of the written file, at the readings and in their bands, shape (P, B_r)."""
        read, solution, at = self.readings, self.solution, self.evidence.at
        if self.written is None and solution.factors is not None and at is not None:
            return np.asarray(
                (solution.weights @ at[0] * solution.factors.at(coordinates(read.wi, read.wo))).T ** 3
            )
        brdf = self.written or self.brdf
        f, nm = brdf.eval(read.wi, read.wo), read.wavelengths_nm
        if nm is not None:
            f = np.array([np.interp(nm, np.array(brdf.bands.wavelengths_nm), row) for row in f])
        return f

    @cached_property
    def gloss_misfits(self) -> dict[float, float]:
        """Relative error of cube roots at the readings of gloss, by angle in degrees."""
        given, at = self.evidence.gloss, self.evidence.at
        if self.written is None and at is not None:
            gloss = GlossReadings.of(given, self.readings.bands, at[1])
            off = gloss.differences(self.solution.weights @ at[1])
        else:
            units = gloss_units(self.written or self.brdf, given)
            off = gloss_differences(np.array(list(units.values())), np.array(list(given.values())))
        return dict(zip(given, off.tolist(), strict=True))

    @cached_property
    def gloss(self) -> dict[float, float]:
        """Gloss units of the completion, by angle in degrees."""
        return gloss_units(self.written or self.brdf, GLOSS_ANGLES_DEG)

    @cached_property
    def misfits(self) -> Array:
        """Relative cube-root error at every reading, over its bands, shape (P,).

        Errors of dark readings are relative to a tenth of the mean. The scatter of repeated readings is included.
        """
        is_read = self.readings.measured
        read = np.cbrt(np.maximum(np.where(is_read, self.readings.values, 0.0), 0.0))
        wrong = np.where(is_read, np.cbrt(np.maximum(self.predicted, 0.0)) - read, 0.0)
        norm = np.linalg.norm(read, axis=1)
        relative = np.linalg.norm(wrong, axis=1) / np.maximum(norm, DARK * norm.mean())
        return np.hypot(relative, self.readings.scatter)

    @cached_property
    def colour_misfits(self) -> Array | None:
        """CIEDE2000 between every reading and the completion there, shape (P,), computed for `viewing`.

        It is None if the readings have no colours.
        """
        return None if self.colours is None else delta_e_2000_lab(*self.colours)

    @property
    def viewing(self) -> Viewing:
        """Light and observer for which `colours` are computed."""
        return DAYLIGHT if self.readings.bands.is_rgb else self.readings.viewing

    @cached_property
    def colours(self) -> tuple[Array, Array] | None:
        """CIELAB colours of the readings and of the completion there, each (P, 3).

        They are computed for `viewing`, and None if the readings have no colours.
        """
        bands = self.readings.bands
        if bands.count < 3 or ((nm := bands.wavelengths_nm) is not None and not nm[0] < _VISIBLE_NM < nm[-1]):
            return None
        read = np.maximum(np.where(self.readings.measured, self.readings.values, self.predicted), 0.0)
        return lab_values(read, bands, self.viewing), lab_values(self.predicted, bands, self.viewing)

    @cached_property
    def residual_of_readings(self) -> float:
        """Root mean square of the relative errors of the readings, or of the gloss if that is larger."""
        of_readings = [] if self.evidence.readings is None else [float(np.sqrt(np.mean(self.misfits**2)))]
        return max(*of_readings, *self.gloss_misfits.values(), 0.0)

    @cached_property
    def colour_error(self) -> float:
        """Expected CIEDE2000 due to estimated spectra, and to the scatter of lightness in repeated readings."""
        read = self.evidence.readings
        if read is None or self.evidence.pictures:
            return 0.0
        reflectance = np.clip(np.pi * np.nanmean(read.values, axis=1), 0.0, 1.0)
        lightness = 116.0 * np.cbrt(reflectance) * read.scatter  # CIELAB: 116 cbrt(Y) - 16
        return float(np.hypot(read.colour_error, np.sqrt(np.mean(lightness**2))))

    # -- pictures -----------------------------------------------------------------------------------------------------

    @property
    def exposures(self) -> Array:
        """Factor by which each picture is brighter than its light and the material predict, shape (P,)."""
        return self.solution.exposures

    @property
    def exposure(self) -> float:
        """The geometric mean of the exposures."""
        return geometric_mean(self.exposures)

    @cached_property
    def picture_errors(self) -> tuple[float, ...]:
        """Relative cube-root error of every picture when it is predicted from the other observations.

        The exposures of the other pictures are then treated as known. Empty for a single picture.
        """
        pictures = self.exposed.pictures
        if len(pictures) <= 1:
            return ()
        errors = []
        for k, picture in enumerate(pictures):
            weights = self.without[f"picture {k + 1}"].solution.weights
            gain = np.array([ratio_of(picture, weights)])
            errors.append(float(residuals_of(Evidence(pictures=[picture]), weights, gain)[0]))
        return tuple(errors)

    @property
    def is_brightness_guessed(self) -> bool:
        """Whether only the library determines the brightness: exposures are unknown, and there are no readings."""
        seen = self.evidence
        return seen.exposure is None and not seen.of_readings and not seen.of_gloss

    @property
    def exposed(self) -> Evidence:
        """The evidence with the pictures divided by their exposures; an unknown exposure stays unknown."""
        return self.evidence.exposed(self.exposures)

    # -- what each observation says ------------------------------------------------------------------------------------

    @cached_property
    def without(self) -> dict[str, Completion]:
        """Completions that each leave out one observation, by its name; empty if there is only one observation.

        The exposures are treated as known.
        """
        seen, readings = self.evidence, self.evidence.readings
        known, n, atoms = (
            replace(self.exposed, exposure=1.0, each=False),
            len(self.evidence.pictures),
            self.atoms,
        )
        left: dict[str, Completion] = {}
        if n > 1:
            for k in range(n):
                others = replace(known, pictures=[*known.pictures[:k], *known.pictures[k + 1 :]])
                left[f"picture {k + 1}"] = Completion.of(atoms, others)
        elif n and readings is not None:
            left["picture 1"] = Completion.of(replace(atoms, is_linear=False), readings)
        if n and readings is not None:
            left["readings"] = Completion.of(atoms, replace(seen, readings=None, of_readings=()))
        if seen.gloss:
            dull = None if readings is None else replace(readings, gloss={})
            at = None if seen.at is None else (seen.at[0], seen.at[1][:, :0])
            left["gloss"] = Completion.of(atoms, replace(seen, readings=dull, gloss={}, of_gloss=(), at=at))
        return left

    @cached_property
    def contributions(self) -> dict[str, float]:
        """Mean CIEDE2000 over a ball by which each observation changes the completion, by name.

        Source: Cook 1977, "Detection of influential observation in linear regression" (deletion of each).
        """
        lights = panel.judged()
        return {
            name: lights.compare(other.ball_xyz, self.ball_xyz).ball for name, other in self.without.items()
        }

    @cached_property
    def ball_xyz(self) -> Array:
        """CIE XYZ values (K, 3) of the ball's pixels in the five test lights, in the order of `Picture.xyz`."""
        if self.atoms.is_linear:
            return srgb_to_xyz(np.clip(self.on_ball, 0.0, 1.0))
        return panel.judged().xyz(self.on_ball, self.bands)

    # -- what is not known --------------------------------------------------------------------------------------------

    @cached_property
    def residual(self) -> float:
        """Relative cube-root error of the observations as they were given, whatever their weights in the fit.

        If there are pictures, it is the error of their pixels, of the readings or of the gloss, whichever is largest.
        Otherwise it is the root mean square over the readings, of the completion or of the mixtures from which it was
        made, whichever is larger.
        """
        if self.evidence.pictures:
            return self.solution.residual
        return max(self.residual_of_readings, self.residual_of_mixtures)

    def factors_at(self, wi: Array, wo: Array) -> Array:
        """Return the factors (P,) within which f at direction pairs (P, 3) is right with a probability of 0.9.

        They cover the materials that explain the observations about as well, see `mixtures.Alike`, averaged over the
        bands or the channels.
        """
        at, logs = self.atoms.at(wi, wo), []
        if self.atoms.is_linear:
            power, stars = 1, self.solution.weights @ at
        else:
            power, stars = 3, self._at(at, coordinates(wi, wo)).mean(axis=1)[None]
        for star, of in zip(stars, self.solution.hypotheses, strict=True):
            alike = of.alike.as_bright_as_atoms if self.is_brightness_guessed else of.alike
            f, f_star = (np.log(np.maximum(values, _LEAST_F)) for values in (alike.of(at) ** power, star))
            off = np.abs(f - f_star)
            logs.append(np.quantile(off, _WITHIN, axis=0, weights=alike.probability, method="inverted_cdf"))
        return np.asarray(np.exp(np.mean(logs, axis=0)))

    @cached_property
    def residual_of_mixtures(self) -> float:
        """Relative error of the mixtures before adjustment, at the readings (mean over bands) or of the pixels."""
        return float(np.sqrt(self._mixtures[0] @ self._squared_misfits))

    @cached_property
    def _mixtures(self) -> tuple[Array, Array]:
        """Probabilities of mixtures, (H,), and weights of atoms, (H, n), of all bands together or of any channel."""
        several = self.solution.hypotheses
        probability = np.concatenate([of.probability for of in several]) / len(several)
        return probability, np.vstack([of.weights for of in several])

    @cached_property
    def _squared_misfits(self) -> Array:
        """Squared relative errors of every mixture, (H,), see `residual_of_mixtures`."""
        if self.evidence.pictures:
            parts = zip(self.solution.channels, self.solution.hypotheses, strict=True)
            return np.array([rows.pixels.relative.error(w) ** 2 for rows, of in parts for w in of.weights])
        readings, at, _ = self.evidence.read
        read = mean_roots(readings)
        wrong = np.sum((self._mixtures[1] @ at - read) ** 2, axis=1)
        return np.asarray(wrong / (read @ read))

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Mixtures that differ visibly from each other on a ball, most probable first."""
        probability, weights = self._mixtures
        order = np.argsort(-probability, kind="stable")
        probability, weights, squares = probability[order], weights[order], self._squared_misfits[order]
        if self.atoms.is_linear:
            curves = np.asarray(np.cbrt(weights @ self.atoms.on_ball))
            importance: Array = np.ones(curves.shape[1])
        else:
            on_ball = slice(self.atoms.n_grid, None)
            curves, importance = weights @ self.atoms.directions[:, on_ball], self.atoms.weights[on_ball]
        mean = probability @ curves
        norm = max(float(mean**2 @ importance), np.finfo(float).tiny)
        groups: list[list[int]] = []
        for h, curve in enumerate(curves):
            apart = [float((curve - curves[group[0]]) ** 2 @ importance) / norm for group in groups]
            if apart and min(apart) < _ALIKE**2:
                groups[int(np.argmin(apart))].append(h)
            else:
                groups.append([h])
        totals = [float(probability[group].sum()) for group in groups]
        largest = np.argsort(totals)[::-1][:_SHOWN_ALTERNATIVES].tolist()
        return tuple(
            Alternative(
                self._materials(weights[group[0]]),
                total,
                float(np.sqrt(probability[group] @ squares[group] / max(total, np.finfo(float).tiny))),
                float(np.sqrt((curves[group[0]] - mean) ** 2 @ importance / norm)),
            )
            for group, total in ((groups[k], totals[k]) for k in largest)
        )

    @property
    def made_of(self) -> tuple[tuple[str, float], ...]:
        """Names of the completion's materials with their weights or, from pictures, shares of the ball's light.

        The list begins with the largest.
        """
        weights = self.solution.weights if self.atoms.is_linear else self.weights
        return self._materials(weights.mean(axis=0))

    def _materials(self, weights: Array) -> tuple[tuple[str, float], ...]:
        """Return the materials of weights (n,) of atoms: their weights, or shares of light for atoms of values."""
        if self.atoms.is_linear:
            light = weights * self.atoms.on_ball.sum(axis=1)
            weights = light / max(light.sum(), np.finfo(float).tiny)
        names = (
            *self.atoms.names,
            *self.atoms.coats,
            "analytic lobes" if self.atoms.is_linear else "Lambertian",
        )
        return shown_shares(
            names, np.bincount(self.atoms.material_of, weights, len(names)).astype(np.float64)
        )

    # -- notes --------------------------------------------------------------------------------------------------------

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about the observations, and about directions, bands and highlights that they do not determine."""
        read = self.evidence.readings
        of_gloss = [
            f"gloss at {angle:g} degrees is not reproduced: {self.gloss[angle]:.3g} units "
            f"instead of {self.evidence.gloss[angle]:.3g}; no combination reproduces both it and the other observations"
            for angle, misfit in self.gloss_misfits.items()
            if misfit > _GLOSS_MISSED
        ]
        if self.evidence.pictures:
            notes = [*of_gloss, *self._notes_of_pictures(), *(() if read is None else read.notes)]
        else:
            notes = [
                *self._too_dark(),
                *of_gloss,
                *self._unexplained(),
                *self._not_reciprocal(),
                *self._unread(),
                *self.readings.notes,
            ]
        return tuple(notes)

    @cached_property
    def times_darker(self) -> float:
        """How many times darker the readings are than the library's darkest material, by mean cube roots.

        The factor is 0 without readings.
        """
        if self.evidence.at is None or self.evidence.readings is None:
            return 0.0
        roots = self.evidence.at[0][: self.atoms.n_measured].reshape(
            len(self.atoms.names), -1, len(self.readings)
        )
        darkest = np.cbrt(np.mean(roots**3, axis=1)).mean(axis=1).min()
        return float(darkest / max(float(mean_roots(self.readings).mean()), np.finfo(float).tiny)) ** 3

    @property
    def is_too_dark(self) -> bool:
        """Whether the readings are so much darker than the library that their unit is doubtful."""
        return self.times_darker > _MUCH_DARKER

    def _too_dark(self) -> list[str]:
        """Return a sentence if the readings are darker than any material of the library."""
        if not self.is_too_dark:
            return []
        return [
            Assumption(
                f"the readings are {self.times_darker:.2g} times darker than the darkest material of the library would "
                "be at their directions: check their unit (--unit)"
            )
        ]

    def _unread(self) -> list[str]:
        """Return sentences on bands and directions without readings."""
        notes = []
        reach = beyond(self.readings, self.atoms.bands)
        if reach is not None and reach[0] == reach[1]:
            notes.append(
                f"read at {reach[0]:g} nm only, which does not determine colours: the result is the same in all bands, "
                f"and the expected errors are those of coloured materials taken as grey"
            )
        elif reach is not None:
            notes.append(
                f"extrapolated below {reach[0]:g} nm and above {reach[1]:g} nm with the weights at these bands"
            )
        wi, wo = self.readings.wi, self.readings.wo
        from_mirror = np.rad2deg(np.arccos(np.clip(cos_from_mirror(wi, wo), -1.0, 1.0)))
        if from_mirror.min() > _NEAR_MIRROR_DEG and not self.evidence.gloss:
            notes.append(
                f"the nearest reading is {from_mirror.min():.0f} degrees from a mirror direction: highlights are "
                "those of materials that agree with the readings; give the gloss of the sample (--gloss), or measure "
                "nearer to a mirror direction"
            )
        return notes

    def _unexplained(self) -> list[str]:
        """Return a sentence if no mixture explains the readings."""
        if self.residual_of_mixtures <= _UNEXPLAINED:
            return []
        return [
            f"no mixture of two materials explains the readings (residual {100.0 * self.residual_of_mixtures:.0f} "
            f"% before the combination is adjusted to them, {100.0 * self.residual_of_readings:.1f} % "
            f"after; most at {self._worst_reading()}): the result follows them, and other directions are uncertain"
        ]

    def _not_reciprocal(self) -> list[str]:
        """Return a sentence if readings of different incidences differ as no reciprocal material does."""
        if self.factors is None or not self.factors.not_reciprocal:
            return []
        difference = self.factors.not_reciprocal
        return [
            f"readings with the directions exchanged differ by {percent(difference)}, more than a reciprocal, "
            "isotropic material allows: the result reproduces both, and its highlight can have rings under a small "
            f"light; check the instrument's geometry, or give --repeatability {ceil(50.0 * difference)}, half the "
            "difference, to fit their mean"
        ]

    def _worst_reading(self) -> str:
        """Return the directions of the reading that the most probable mixtures miss most."""
        readings, at, _ = self.evidence.read
        probability, weights = self._mixtures
        off = probability @ np.abs(weights @ at - mean_roots(readings))
        theta_i, theta_o, azimuth = angles_from_mirror(readings.wi, readings.wo)[int(np.argmax(off))]
        return f"incidence {theta_i:.0f}, outgoing {theta_o:.0f}, azimuth {azimuth:.0f} degrees from the mirror side"

    def _notes_of_pictures(self) -> list[str]:
        """Return sentences on missing light, and on the agreement of light, pictures and other observations."""
        notes, readings = list(self.evidence.unlit), self.evidence.readings
        if self.evidence.strength > 0.0:
            notes.append(
                "the light is clipped: the fit to the pixels makes its spots "
                f"{1.0 + self.evidence.strength:.3g} times as bright as in its picture; expected errors ignore the "
                "uncertainty of this factor"
            )
        notes += self._differing_exposures()
        if self.is_brightness_guessed:
            notes.append(
                "the exposure was estimated from how bright the library's materials are: luminance may be off by a "
                "factor of two and more"
            )
        if self.solution.contradiction > CONTRADICTION:
            notes.append(
                "readings and photographs contradict each other, so the photographs get less weight: check that both "
                "show the same material, and the light of the photographs"
            )
        if readings is not None and not readings.bands.is_rgb:
            notes.append(
                "spectra follow the readings; photographs determine how three channels change with direction"
            )
        elif not self.bands.is_rgb:
            notes.append(
                "spectra are estimated from three channels: bands that no channel sees follow the library's"
            )
        return notes

    def _differing_exposures(self) -> list[str]:
        """Say that pictures which were taken as equally exposed agree better with an exposure each."""
        together = self.solution.residual_of_pixels
        if self.evidence.each or len(self.evidence.pictures) == 1 or together <= NOISY:
            return []
        apart = solve_pictures(self.atoms, replace(self.evidence, each=True))
        residual, gains = apart.residual_of_pixels, relative(apart.exposures)
        if residual > _MUCH_LESS * together:
            return []
        return [
            f"the pixels have a residual of {100.0 * together:.2g} % with one exposure for all pictures, and of "
            f"{100.0 * residual:.2g} % with {gains.min():.2g} to {gains.max():.2g} times their mean: if "
            "the lamp or the camera's settings differed, give --exposure each"
        ]
