"""Measured files reconstructed from the materials of a library: errors, and the reconstruction as a file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from manifold import __version__
from manifold.brdf.measured import BRDF, MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.brdf.unmeasured import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.errors import UsageError
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.checked_file import require_bsdf_output, write_checked
from manifold.model.comparison import brdf_errors
from manifold.model.materials import MaterialCache, names_without
from manifold.model.prediction import ClippedBRDF
from manifold.model.reconstruction import reconstruct
from manifold.model.settings import Settings
from manifold.records import Progress, evenly_spaced

_SHOWN_PARTS = 5


@dataclass(frozen=True)
class Reconstruction:
    """Errors of a reconstruction of a measured file, and the file that it was written to.

    Attributes:
        relative_error: `||w (f* - f)|| / ||w f||`, w = cos(theta_i) cos(theta_o), see `brdf_errors`.
        cube_root_error: the same of cube roots.
        ball: mean CIEDE2000 of the ball.
        output: the file that it was written to, or None.
        plausibility: of that file.
        diagnostics: defects found, as sentences.
    """

    relative_error: float
    cube_root_error: float
    ball: float
    output: Path | None
    plausibility: Plausibility | None
    diagnostics: tuple[str, ...]

    @property
    def rows(self) -> dict[str, object]:
        """Labels and values for a terminal."""
        errors = [
            f"{self.ball:.1f} CIEDE2000 of the ball",
            f"{self.cube_root_error:.0%} cube-root error",
            f"{self.relative_error:.0%} linear",
        ]
        rows: dict[str, object] = {"reconstruction error": errors}
        if self.plausibility is not None:
            rows |= {"written to": str(self.output), "largest albedo": f"{self.plausibility.max_albedo:.3f}"}
        return rows | ({"diagnostics": self.diagnostics} if self.diagnostics else {})

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        written = {
            "output": self.output and str(self.output), "plausibility": self.plausibility and vars(self.plausibility),
        }  # fmt: skip
        return vars(self) | written


def read_filled(path: Path) -> tuple[MeasuredBRDF, tuple[str, ...]]:
    """A measured file with its unmeasured cells filled, and diagnostics of these.

    Raises:
        FileFormatError: it is no RGL file.
    """
    file = read_bsdf(path)
    cells = unmeasured_cells(file)
    brdf, share = MeasuredBRDF(fill_unmeasured(file, cells)), unmeasured_share(file, cells)
    return brdf, diagnostics.of_unmeasured(share)


def judge(
    brdf: MeasuredBRDF,
    found: BRDF,
    output: Path | None,
    how: str,
    *,
    physical: bool = False,
    force: bool = False,
) -> Reconstruction:
    """Compare a reconstruction with its material, and write it where an output is named.

    Args:
        brdf: the material.
        found: its reconstruction.
        output: a `.bsdf` file, or None.
        how: how it was made, for the description of the file.
        physical: project the file to non-negative, reciprocal within 5 %, and albedo at most 1.
        force: also write a file whose albedo exceeds 1.05.
    Raises:
        UsageError: the output cannot be written, or its albedo would exceed 1.05.
    """
    errors = brdf_errors(brdf, found)
    sentences = diagnostics.of_anisotropy(brdf.is_isotropic, found.is_isotropic)
    plausibility = None
    if output is not None:
        description = f"Reconstruction of {brdf.name} {how} by manifold {__version__}"
        plausibility = write_checked(
            output, ClippedBRDF(found), description=description, remedy="scale it with --physical",
            physical=physical, force=force,
        )  # fmt: skip
        sentences += diagnostics.of_prediction(False, plausibility)
        sentences += diagnostics.of_projection(plausibility) if physical else ()
    return Reconstruction(errors.linear, errors.cube_root, errors.ball, output, plausibility, sentences)


@dataclass(frozen=True)
class Reconstructed:
    """A file as non-negative combination of the bands of a library's materials and analytic lobes.

    Attributes:
        path: the file.
        materials: how many took part.
        parts: materials and analytic lobes with the largest shares of the weights.
        reconstruction: errors, and the written file.
    """

    path: Path
    materials: int
    parts: tuple[tuple[str, float], ...]
    reconstruction: Reconstruction

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        content = {"program": f"manifold {__version__}", "path": str(self.path)}
        return content | {"materials": self.materials, "parts": self.parts} | self.reconstruction.to_json()


def reconstruct_file(
    library: Path,
    path: Path,
    output: Path,
    *,
    without: Collection[str] = (),
    physical: bool = False,
    force: bool = False,
    on_progress: Progress | None = None,
) -> Reconstructed:
    """Reconstruct a measured file by non-negative least squares, see `reconstruct`, and write it as an RGL file.

    Args:
        library: of measured materials in the same bands.
        path: the measured file.
        output: the file to write.
        without: names of materials that take no part.
        physical, force: see `judge`.
        on_progress: called with (done, total, what) while materials are read.
    Raises:
        FileFormatError: it is no RGL file.
        BandMismatchError: its bands are not the library's.
        UsageError: it is black, no material is left, there is none of a name in `without`, or see `judge`.
    """
    require_bsdf_output(output, "reconstructions")
    opened = Library.open(library)
    names = names_without(opened, without)
    if not names:
        raise UsageError(
            f"{library}: no material is left to reconstruct from; import others, or leave out fewer"
        )
    brdf, notes = read_filled(path)
    opened.bands.require_same(brdf.bands, path.name, "resample it, or use its own library")
    materials = MaterialCache(opened, names, is_nonnegative=True)
    bands = evenly_spaced(opened.bands.count, Settings().sample_bands)
    materials.in_bands(bands.tolist(), on_progress)
    found = reconstruct(materials, bands, brdf)
    made = judge(
        brdf, found, output, f"from {len(names)} materials and analytic lobes", physical=physical, force=force
    )
    if brdf.name in names:
        notes += (
            f"{brdf.name} is in the library and reconstructed from itself, too; leave it out with --without "
            f"{brdf.name} to see the errors of a new material",
        )
    made = replace(made, diagnostics=notes + made.diagnostics)
    return Reconstructed(path, len(names), tuple(found.parts[:_SHOWN_PARTS]), made)
