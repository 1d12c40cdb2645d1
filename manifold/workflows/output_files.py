"""Writing of predicted BRDFs as RGL files whose albedo is checked."""

from __future__ import annotations

from pathlib import Path

from manifold.brdf.measured import BRDF
from manifold.brdf.plausibility import Plausibility
from manifold.errors import UsageError
from manifold.io_rgl import material_name, write_bsdf
from manifold.model import diagnostics
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions, output_file
from manifold.system import atomic


def require_bsdf_output(output: Path) -> None:
    """Raise UsageError, before the work is done, unless a path ends in `.bsdf` and can be written."""
    if output.suffix != ".bsdf" or not material_name(output):
        raise UsageError(f"{output}: expected a name that ends in .bsdf")
    atomic.require_writable(output)


def write_checked(
    output: Path,
    brdf: BRDF,
    options: OutputOptions = DEFAULT_OPTIONS,
    *,
    description: str = "",
    remedy: str = "make it physical",
    keeps_hue: bool = False,
) -> Plausibility:
    """Measure a BRDF with the virtual goniometer, and write the file unless its albedo is above 1.05.

    Args:
        output: the file; its name becomes the material's.
        brdf: what is measured, without negative values.
        options, description, keeps_hue: see `output_file`.
        remedy: what to do about a file whose albedo exceeds 1.05, besides forcing it.
    Returns:
        The plausibility of the written file.
    Raises:
        UsageError: its albedo would exceed 1.05, and `force` is not set.
    """
    file, found = output_file(
        brdf, material_name(output), options, description=description, keeps_hue=keeps_hue
    )
    if found.max_albedo > diagnostics.MOST_ALBEDO and not options.force:
        raise UsageError(
            f"{output}: would have a directional albedo of {found.max_albedo:.2f} at an incidence up to 85 degrees, "
            f"expected at most {diagnostics.MOST_ALBEDO}; {remedy}, or force it"
        )
    write_bsdf(output, file)
    return found
