"""Materials of a library by colour and gloss, or by their likeness to another material."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from manifold import progress
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz, to_xyz
from manifold.colour.difference import delta_e_2000, delta_e_2000_lab
from manifold.errors import UsageError
from manifold.estimate.attributes import LEAST_GLOSS, lab_of
from manifold.estimate.gloss import gloss_units
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.records import Array

_JUST_VISIBLE = np.log(1.2)  # of log gloss: a fifth more, about as visible as a CIEDE2000 of 1


@dataclass(frozen=True, eq=False)
class Found:
    """A measured material beside what was looked for.

    Attributes:
        name: of the material.
        lab: its CIELAB colour in the geometry 45/0, shape (3,).
        gloss: its gloss units by angle in degrees.
        ciede2000: to the colour looked for; None where none was given.
        distance: root of the summed squares of CIEDE2000 and of gloss in just visible steps; from a material, the
            CIEDE2000 between both.
    """

    name: str
    lab: Array
    gloss: Mapping[float, float]
    ciede2000: float | None
    distance: float

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return vars(self) | {
            "lab": self.lab.tolist(),
            "gloss": {f"{a:g}": units for a, units in self.gloss.items()},
        }


def find(
    library: Library,
    lab: ArrayLike | None,
    gloss: Mapping[float, float],
) -> list[Found]:
    """The materials of a library, those nearest to a colour and gloss first.

    Args:
        library: of measured materials.
        lab: CIELAB colour in the geometry 45/0 under D65, shape (3,); None for any.
        gloss: gloss units by angle in degrees, 20, 60 or 85.
    Raises:
        UsageError: gloss meters have no such angle.
        LibraryError: a material cannot be read.
    """
    found = []
    for k, name in enumerate(library.names):
        brdf = MeasuredBRDF(library.read(name))
        own, units = lab_of(brdf), gloss_units(brdf, gloss or (60.0,))
        difference = None if lab is None else float(delta_e_2000_lab(np.asarray(lab), own))
        steps = [
            np.log(max(units[a], LEAST_GLOSS) / max(asked, LEAST_GLOSS)) / _JUST_VISIBLE
            for a, asked in gloss.items()
        ]
        found.append(
            Found(name, own, units, difference, float(np.hypot(difference or 0.0, np.linalg.norm(steps))))
        )
        progress.report(k + 1, len(library.names), "materials")
    return sorted(found, key=lambda one: one.distance)


def find_like(library: Library, sought: BRDF | Readings) -> list[Found]:
    """The materials of a library, those that look most like another first.

    Args:
        library: of measured materials.
        sought: a BRDF, compared as balls in the judged lights of `colour.panel`; or readings, compared at their
            geometries, in which case materials without gloss near it may be listed.
    Raises:
        LibraryError: a material cannot be read.
        UsageError: the readings have no colours.
    """
    differs = _from_readings(sought) if isinstance(sought, Readings) else _from_ball(sought)
    found = []
    for k, name in enumerate(library.names):
        brdf = MeasuredBRDF(library.read(name))
        difference = differs(brdf)
        found.append(Found(name, lab_of(brdf), gloss_units(brdf, (60.0,)), difference, difference))
        progress.report(k + 1, len(library.names), "materials")
    return sorted(found, key=lambda one: one.distance)


def _from_ball(sought: BRDF) -> Callable[[BRDF], float]:
    lights = panel.judged()

    def xyz(brdf: BRDF) -> Array:
        return lights.xyz(np.maximum(brdf.eval(lights.wi, lights.wo), 0.0), brdf.bands)

    own = xyz(sought)
    return lambda brdf: lights.compare(own, xyz(brdf)).ball


def _from_readings(sought: Readings) -> Callable[[BRDF], float]:
    white = srgb_to_xyz(np.ones(3))
    whole = sought.measured.all(axis=1)
    if sought.bands.count < 3 or not whole.any():
        raise UsageError(
            f"{sought.name}: {sought.bands}, expected readings with colours to compare materials by"
        )
    wi, wo = sought.wi[whole], sought.wo[whole]
    own = to_xyz(np.pi * np.maximum(sought.values[whole], 0.0), sought.bands)
    return lambda brdf: float(
        delta_e_2000(own, to_xyz(np.pi * np.maximum(brdf.eval(wi, wo), 0.0), brdf.bands), white).mean()
    )
