"""A BRDF as an RGL file in memory, measured by the virtual goniometer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from manifold.brdf import goniometer
from manifold.brdf.measured import BRDF
from manifold.brdf.physical import physical_file
from manifold.brdf.plausibility import Plausibility, plausibility_of_file
from manifold.model import diagnostics
from manifold.records import BsdfFile


@dataclass(frozen=True)
class OutputOptions:
    """How a BRDF becomes an RGL file.

    Attributes:
        physical: project the file to non-negative values, reciprocity within 5 %, and albedo at most 1.
        force: also write a file whose albedo exceeds 1.05.
        resolution: nodes per axis of the outgoing grid; with `physical`, at least.
        incidences: incident elevations from 0 to 90 degrees, at least; see `output_file`.
    """

    physical: bool = False
    force: bool = False
    resolution: int = 32
    incidences: int = 8


DEFAULT_OPTIONS = OutputOptions()


def output_file(
    brdf: BRDF,
    name: str,
    options: OutputOptions = DEFAULT_OPTIONS,
    *,
    description: str = "",
    keeps_hue: bool = False,
) -> tuple[BsdfFile, Plausibility]:
    """Measure a BRDF without negative values into a file, and the plausibility of that file.

    A file whose albedo exceeds 1.05 is measured again with twice as many incidences, which resolve sharp highlights
    near grazing, and returned so where its albedo then does not. A file with a valley beside its highlight is measured
    again with a softer normal distribution; the better one of the two is returned.

    Args:
        brdf: what is measured.
        name: of the material.
        options: see `OutputOptions`.
        description: of the file.
        keeps_hue: scale all bands alike where the albedo of one is too large.
    """
    measure = partial(
        partial(physical_file, keeps_hue=keeps_hue) if options.physical else goniometer.measure,
        brdf,
        name,
        description=description,
        resolution=options.resolution,
        n_theta_i=options.incidences,
        version=(1, 0) if brdf.bands.is_rgb else (3, 1),
    )
    file = measure()
    found = plausibility_of_file(file)
    if found.max_albedo > diagnostics.MOST_ALBEDO:
        finer = measure(n_theta_i=2 * options.incidences)
        resolved = plausibility_of_file(finer)
        if resolved.max_albedo <= diagnostics.MOST_ALBEDO:
            return finer, resolved
    if found.highlight_valley > diagnostics.MOST_VALLEY:
        soft = measure(bend=goniometer.SOFT_BEND)
        softly = plausibility_of_file(soft)
        if softly.highlight_valley < found.highlight_valley:
            return soft, softly
    return file, found
