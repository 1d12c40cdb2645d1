"""Writing of predicted BRDFs as RGL files whose albedo is checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.brdf.measured import BRDF
from manifold.brdf.plausibility import Plausibility
from manifold.errors import UsageError
from manifold.io_rgl import material_name, write_bsdf
from manifold.model import diagnostics
from manifold.model.comparison import BRDFErrors
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions, output_file
from manifold.records import BsdfFile
from manifold.system import atomic


def require_bsdf_output(output: Path) -> None:
    """Raise UsageError, before the work is done, unless a path ends in `.bsdf` and can be written."""
    if output.suffix != ".bsdf" or not material_name(output):
        raise UsageError(f"{output}: expected a name that ends in .bsdf")
    atomic.require_writable(output)


@dataclass(frozen=True)
class WrittenFile:
    """A file that was written, or refused.

    Attributes:
        plausibility: of the file.
        file: what was written; None where it was refused.
        projection, change: see `OutputFile`.
        refusal: why it was not written, else None.
    """

    plausibility: Plausibility
    file: BsdfFile | None = None
    projection: tuple[str, ...] = ()
    change: BRDFErrors | None = None
    refusal: str | None = None


def write_output(
    output: Path,
    brdf: BRDF,
    options: OutputOptions = DEFAULT_OPTIONS,
    *,
    description: str = "",
    remedy: str = "make it physical",
    keeps_hue: bool = False,
) -> WrittenFile:
    """Measure a BRDF with the virtual goniometer, and write the file; a strict one only if its albedo is at most 1.05.

    Args:
        output: the file; its name becomes the material's.
        brdf: what is measured, without negative values.
        options, description, keeps_hue: see `output_file`.
        remedy: what to do about a file whose albedo exceeds 1.05, besides taking it as it is.
    """
    name = material_name(output)
    file, found, projection, change = output_file(
        brdf, name, options, description=description, keeps_hue=keeps_hue
    )
    if found.max_albedo > diagnostics.MOST_ALBEDO and options.strict:
        return WrittenFile(
            found,
            refusal=f"{output}: would have an albedo of {found.max_albedo:.2f} at "
            f"{found.albedo_incidence_deg:.0f} degrees, expected at most {diagnostics.MOST_ALBEDO}; {remedy}, or write "
            "it with a warning: options physical, strict",
        )
    write_bsdf(output, file)
    return WrittenFile(found, file, projection, change)


def write_checked(
    output: Path, brdf: BRDF, options: OutputOptions = DEFAULT_OPTIONS, **how: Any
) -> WrittenFile:
    """The same, with a refusal as an error.

    Raises:
        UsageError: its albedo would exceed 1.05, and `strict` is set.
    """
    written = write_output(output, brdf, options, **how)
    if written.refusal is not None:
        raise UsageError(written.refusal)
    return written
