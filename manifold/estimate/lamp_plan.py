"""Suggests lamp positions for photographs of a ball: those from which the estimated BRDF has the smallest errors.

Each of the library's materials is left out and estimated from simulated photographs with the others. For an isotropic
material, only the angle between lamp and camera matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manifold.colour.difference import delta_e_2000_lab, lab_values
from manifold.core import progress
from manifold.core.records import Array, Bands, evenly_spaced
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.evidence import Evidence, channel_atoms
from manifold.estimate.expected import errors_of_weights
from manifold.estimate.gloss import gloss_meter
from manifold.estimate.lamps import Lamp, lamp_pairs
from manifold.estimate.pixels import Blocks, Camera, block_sums
from manifold.estimate.solving import estimate
from manifold.formats.readings import aspecular_pair
from manifold.library.store import Library
from manifold.model.estimator import Observation

ANGLES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 110.0, 130.0)
"""Angles between lamp and camera, seen from the ball, that are tried."""

_LEFT_OUT = 10  # materials by which errors are measured
_ACROSS, _WITHIN = 18, 0.95  # pixels across a ball, and of its radius
_GLOSS_DEG = 60.0
_RGB = Bands(None)


class Determined(NamedTuple):
    """Median errors over left-out materials.

    Attributes:
        angles_deg: angles between lamps and camera, of all photographs.
        ball: ball error, mean CIEDE2000 in the five test lights.
        colour: CIEDE2000 in the geometry 45/0.
        gloss: relative error of the gloss at 60 degrees.
        flop: error of the difference of L* between aspecular angles of 15 and 110 degrees, with light at 45 degrees.
    """

    angles_deg: tuple[float, ...]
    ball: float
    colour: float
    gloss: float
    flop: float


@dataclass(frozen=True)
class LampPlan:
    """Recommended positions of a lamp.

    Attributes:
        alone: errors with one further photograph, for each angle of its lamp.
        next: the photographs to take, in order, each with the errors after it.
    """

    alone: tuple[Determined, ...]
    next: tuple[Determined, ...]


def plan_lamps(
    library: LibraryAtoms | Path, count: int, known: Sequence[Observation] | None = None
) -> LampPlan:
    """Return the lamps that minimise the expected ball error, chosen one after the other.

    `library` is the path of a library, or its atoms of values; `known` holds the rows of existing photographs by
    channel.
    """
    atoms = (
        library if isinstance(library, LibraryAtoms) else LibraryAtoms.of_library(Library(library)).in_values
    )
    chosen: list[Determined] = []
    alone: list[Determined] = []
    for step in range(count):
        angles = chosen[-1].angles_deg if chosen else ()
        tried = []
        for k, angle in enumerate(ANGLES_DEG):
            progress.report(
                step * len(ANGLES_DEG) + k, count * len(ANGLES_DEG), f"a lamp at {angle:g} degrees"
            )
            tried.append(determined(atoms, (*angles, angle), known))
        alone = alone or tried
        chosen.append(min(tried, key=lambda one: one.ball))
    return LampPlan(tuple(alone), tuple(chosen))


def determined(
    atoms: LibraryAtoms, angles_deg: Sequence[float], known: Sequence[Observation] | None
) -> Determined:
    """Return the errors to expect from photographs under distant lamps at angles from the camera; see `plan_lamps`."""
    pictures = [picture_rows(atoms, angle) for angle in angles_deg]
    if known is not None:
        level = float(np.mean(known[0].weights))
        pictures = [[replace(row, weights=level * row.weights) for row in rows] for rows in pictures]
        pictures.append(list(known))
    meter = gloss_meter(_GLOSS_DEG)
    pairs = [aspecular_pair(45.0, aspecular) for aspecular in (45.0, 15.0, 110.0)]
    wi, wo = (np.array(ends) for ends in zip(*pairs, strict=True))
    at, shine = atoms.at(wi, wo), meter.of(atoms.at(meter.wi, meter.wo).T)[0]
    errors, evidence = [], Evidence(pictures=pictures)
    for m in evenly_spaced(len(atoms.names), _LEFT_OUT):
        own = channel_atoms(atoms, m)
        rows = evidence.of_material(atoms, m).under(np.ones(len(pictures)))
        weights, _ = estimate(atoms, rows, atoms.material_of != m)
        lab, found = (lab_values(values.T, _RGB) for values in (at[own], weights @ at))
        units, made = (float(np.mean(of)) for of in (shine[own], weights @ shine))
        errors.append(
            (
                errors_of_weights(atoms, m, weights).ball,
                float(delta_e_2000_lab(lab[0], found[0])),
                float(np.expm1(abs(np.log(max(made, 1e-9) / max(units, 1e-9))))),
                abs(float(np.ptp(lab[1:, 0]) - np.ptp(found[1:, 0]))),
            )
        )
    return Determined(tuple(angles_deg), *np.median(errors, axis=0).tolist())


@lru_cache(maxsize=len(ANGLES_DEG))
def picture_rows(atoms: LibraryAtoms, angle_deg: float) -> list[Observation]:
    """Return the pixels of atoms in a photograph under one lamp, channel by channel."""
    across = _WITHIN * (2.0 * (np.arange(_ACROSS) + 0.5) / _ACROSS - 1.0)
    x, y = (grid.ravel() for grid in np.meshgrid(across, across))
    inside = np.hypot(x, y) < _WITHIN
    x, y = x[inside], y[inside]
    ones: Array = np.ones(len(x))
    places = Blocks(
        x, y, np.arange(len(x)), 2.0 * _WITHIN / _ACROSS, np.zeros((len(x), 3)), np.zeros((len(x), 3), bool)
    )
    turn = np.deg2rad(angle_deg)
    lamp = Lamp(np.array([0.0, np.sin(turn), np.cos(turn)]))
    sums = block_sums(atoms.at, *lamp_pairs(places, Camera(), [lamp]))
    return [Observation(sums[:, c], 0.0 * ones, ones, np.zeros(len(x), bool)) for c in range(sums.shape[1])]
