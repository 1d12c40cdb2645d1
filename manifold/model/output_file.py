"""Writes a BRDF as an RGL file: measures it virtually, makes it physical on request, and checks it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.physical import physical_file
from manifold.brdf.plausibility import Plausibility, plausibility_of_file
from manifold.core import disk
from manifold.core.defaults import FINE_INCIDENCES
from manifold.core.errors import UsageError
from manifold.core.metrics import Errors, Number
from manifold.core.names import exceeds
from manifold.core.records import BsdfFile
from manifold.io_rgl import material_name, write_bsdf
from manifold.model import diagnostics
from manifold.model.comparison import brdf_errors

EXPECTED_ERROR = "expected_cube_root_error"
"""Name of the field in files of completions and predictions that holds the expected cube-root error, float32, (1,)."""


@dataclass(frozen=True)
class OutputOptions:
    """Options of the RGL file that is written from a BRDF.

    Attributes:
        physical: make the file non-negative, reciprocal within 5 %, and its albedo at most 1.
        strict: refuse to write a file whose albedo exceeds 1.05; otherwise it is written with a warning.
        resolution: nodes per axis of the outgoing grid; `physical` may increase it.
        incidences: smallest number of angles of incidence from 0 to 90 degrees; see `output_file`.
    """

    physical: bool = False
    strict: bool = False
    resolution: int = 32
    incidences: int = 8


DEFAULT_OPTIONS = OutputOptions()
COMPLETION_OPTIONS = OutputOptions(incidences=FINE_INCIDENCES)
FINE_OPTIONS = OutputOptions(resolution=48, incidences=FINE_INCIDENCES)
"""Options for temporary files that represent a prediction.

Near the mirror directions of 20 measured materials, such files differ from the prediction by 0.2 to 7 % (median
1.3 %), files of the default options by 3 to 18 % (median 6 %); see `plausibility.mirror_difference`.
"""


class OutputFile(NamedTuple):
    """The file of a BRDF, and its physical plausibility.

    Attributes:
        projection: sentences that say what making the file physical changed, and which faults remain; empty unless
            this was requested.
        change: errors of the physical file with respect to the file without this change; None unless it was
            requested.
    """

    file: BsdfFile
    plausibility: Plausibility
    projection: tuple[str, ...] = ()
    change: Errors[float] | None = None


def output_file(
    brdf: BRDF,
    name: str,
    options: OutputOptions = DEFAULT_OPTIONS,
    *,
    description: str = "",
    keeps_hue: bool = False,
) -> OutputFile:
    """Sample a non-negative BRDF into an RGL file.

    If the albedo of the file exceeds 1.05, the BRDF is measured again with twice as many incidences, which resolve
    sharp highlights near grazing, and the new file is used if its albedo does not exceed 1.05. If the file has a dip
    beside its highlight, it is measured again with a softer normal distribution, and the better file is used. With
    `physical`, the file is then made physical; with `keeps_hue`, all bands are scaled equally if the albedo of one is
    too large.
    """
    measure = partial(
        goniometer.measure,
        brdf,
        name,
        description=description,
        version=(1, 0) if brdf.bands.is_rgb else (3, 1),
        resolution=options.resolution,
    )
    file, bend = measure(n_theta_i=options.incidences), None
    found = plausibility_of_file(file)
    is_resolved = False
    if found.max_albedo > diagnostics.MOST_ALBEDO:
        finer = measure(n_theta_i=2 * options.incidences)
        of_finer = plausibility_of_file(finer)
        if is_resolved := of_finer.max_albedo <= diagnostics.MOST_ALBEDO:
            file, found = finer, of_finer
    if not is_resolved and found.highlight_valley > diagnostics.MOST_VALLEY:
        soft = measure(n_theta_i=options.incidences, bend=goniometer.SOFT_BEND)
        of_soft = plausibility_of_file(soft)
        if of_soft.highlight_valley < found.highlight_valley:
            file, found, bend = soft, of_soft, goniometer.SOFT_BEND
    if not options.physical:
        return OutputFile(file, found)

    def measured(n_theta_i: int, resolution: int) -> BsdfFile:
        return measure(n_theta_i=n_theta_i, resolution=resolution, bend=bend)

    projected = physical_file(file, measured, keeps_hue=keeps_hue)
    after = plausibility_of_file(projected)
    change = brdf_errors(MeasuredBRDF(file), MeasuredBRDF(projected))
    return OutputFile(projected, after, diagnostics.of_projection(found, after, change), change)


def require_bsdf_output(output: Path) -> None:
    """Raise UsageError unless a path ends in `.bsdf` and can be written; call it before the work begins."""
    if output.suffix != ".bsdf" or not material_name(output):
        raise UsageError(f"{output}: expected a name that ends in .bsdf")
    disk.require_writable(output)


@dataclass(frozen=True)
class WrittenFile:
    """The outcome of writing a file, which may be refused.

    Attributes:
        file: the written file; None if it was refused.
        projection, change: see `OutputFile`.
        refusal: reason why the file was not written; None if it was.
    """

    plausibility: Plausibility
    file: BsdfFile | None = None
    projection: tuple[str, ...] = ()
    change: Errors[float] | None = None
    refusal: str | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences about defects of the file, and about what making it physical changed."""
        return (*diagnostics.of_prediction(False, self.plausibility), *self.projection)

    def expected(self, errors: Errors[Number]) -> Errors[Number]:
        """Return the expected errors of the file: those of the BRDF, combined with the change by `--physical`."""
        return errors if self.change is None else errors.beside(self.change)


def write_output(
    output: Path,
    brdf: BRDF,
    options: OutputOptions = DEFAULT_OPTIONS,
    *,
    description: str = "",
    remedy: str = "make it physical",
    keeps_hue: bool = False,
    expected_error: float | None = None,
) -> WrittenFile:
    """Measure a non-negative BRDF with the virtual goniometer, and write the file.

    The material is named after the file. With `strict`, the file is refused if its albedo exceeds 1.05; the refusal's
    text ends with `remedy`. `expected_error`, a relative error of cube roots, is stored in the field
    `EXPECTED_ERROR`.
    """
    name = material_name(output)
    file, plausibility, projection, change = output_file(
        brdf, name, options, description=description, keeps_hue=keeps_hue
    )
    if exceeds(plausibility.max_albedo, diagnostics.MOST_ALBEDO, 2) and options.strict:
        return WrittenFile(
            plausibility,
            refusal=f"{output}: would have an albedo of {plausibility.max_albedo:.2f} at "
            f"{plausibility.albedo_incidence_deg:.0f} degrees, expected at most {diagnostics.MOST_ALBEDO}; "
            f"{remedy}, or write it with a warning: options physical, strict",
        )
    if expected_error is not None:
        file = replace(file, extra={EXPECTED_ERROR: np.array([expected_error], np.float32)})
    write_bsdf(output, file)
    return WrittenFile(plausibility, file, projection, change)


def write_checked(
    output: Path, brdf: BRDF, options: OutputOptions = DEFAULT_OPTIONS, **how: Any
) -> WrittenFile:
    """Write a file by `write_output`; raise UsageError if it was refused."""
    written = write_output(output, brdf, options, **how)
    if written.refusal is not None:
        raise UsageError(written.refusal)
    return written
