"""A predicted BRDF as an RGL file whose albedo is checked."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from manifold.brdf import goniometer
from manifold.brdf.physical import physical_file
from manifold.brdf.plausibility import Plausibility, plausibility_of_file
from manifold.errors import UsageError
from manifold.io_rgl import material_name, write_bsdf
from manifold.model import diagnostics
from manifold.model.prediction import ClippedBRDF
from manifold.system import atomic


def require_bsdf_output(output: Path, what: str) -> None:
    """Check where a file is to be written, before the work is done.

    Args:
        output: its path.
        what: what is written, in words.
    Raises:
        UsageError: the name does not end in `.bsdf`, or the file cannot be written.
    """
    if output.suffix != ".bsdf" or not material_name(output):
        raise UsageError(f"{output}: {what} are written as .bsdf files; name one with -o NAME.bsdf")
    atomic.require_writable(output)


def write_checked(
    output: Path,
    brdf: ClippedBRDF,
    *,
    description: str,
    remedy: str,
    physical: bool = False,
    keeps_hue: bool = False,
    force: bool = False,
    resolution: int = 32,
    n_theta_i: int = 8,
) -> Plausibility:
    """Measure a BRDF with the virtual goniometer, and write the file unless its albedo is above 1.05.

    A file with a valley beside its highlight is measured again with a softer normal distribution; the better one of
    the two is written.

    Args:
        output: the file; its name becomes the material's.
        brdf: what is measured.
        description: of the file.
        remedy: what to do about a file whose albedo exceeds 1.05, besides forcing it.
        physical: project the file to non-negative, reciprocal within 5 %, and albedo at most 1.
        keeps_hue: scale all bands alike where the albedo of one is too large.
        force: write it whatever its albedo.
        resolution: nodes per axis of the outgoing grid; with `physical`, at least.
        n_theta_i: incident elevations; with `physical`, at least.
    Returns:
        The plausibility of the written file.
    Raises:
        UsageError: its albedo would exceed 1.05.
    """
    measure = partial(
        partial(physical_file, keeps_hue=keeps_hue) if physical else goniometer.measure,
        brdf,
        material_name(output),
        description=description,
        resolution=resolution,
        n_theta_i=n_theta_i,
        version=(1, 0) if brdf.bands.is_rgb else (3, 1),
    )
    file = measure()
    found = plausibility_of_file(file)
    if found.highlight_valley > diagnostics.MOST_VALLEY:
        soft = measure(bend=goniometer.SOFT_BEND)
        softly = plausibility_of_file(soft)
        if softly.highlight_valley < found.highlight_valley:
            file, found = soft, softly
    if found.max_albedo > diagnostics.MOST_ALBEDO and not force:
        raise UsageError(
            f"{output}: would have a directional albedo of {found.max_albedo:.2f} at an incidence up to 85 degrees, "
            f"expected at most {diagnostics.MOST_ALBEDO}; {remedy}, or use --force"
        )
    write_bsdf(output, file)
    return found
