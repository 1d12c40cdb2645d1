"""Describes measured files by a map or a library, and writes the result as an RGL file with its errors."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypeVar

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import fill_unmeasured
from manifold.core.progress import Stages
from manifold.core.records import BsdfFile
from manifold.estimate.source_files import read_source
from manifold.estimate.sources import FileSource, MaterialSource
from manifold.library.store import Library
from manifold.model import diagnostics, location
from manifold.model.comparison import brdf_errors
from manifold.model.location import Located, Reconstruction
from manifold.model.manifold import Manifold, load_model
from manifold.model.output_file import (
    DEFAULT_OPTIONS,
    OutputOptions,
    require_bsdf_output,
    write_checked,
    write_output,
)
from manifold.model.prediction import ClippedBRDF

if TYPE_CHECKING:
    from manifold.estimate.completions import Photographed
    from manifold.estimate.sightings import PhotoRequest

_R = TypeVar("_R", bound=Reconstruction)


def locate(
    model: Manifold | Path | str,
    path: Path | str | MaterialSource,
    output: Path | str | None = None,
    *,
    library: Path | str | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> Located:
    """Locate a measured file on a fitted manifold, see `manifold.model.location.locate`.

    If `strict` is set, an output whose albedo exceeds 1.05 is not written, and `refusal` states the reason. If the
    output was made physical, the errors refer to the written file.

    Args:
        model: a fitted manifold, or the path of one.
        path: the measured file, or another material.
        output: a `.bsdf` file for the prediction at the latent, in the colours found; None writes none.
        library: path of the model's library, if the library was moved.
        options: options of the output.

    Raises:
        FileFormatError: the file is not an RGL file.
        BandMismatchError: the file has other bands than the library.
        UsageError: the output cannot be written.
    """
    if output is not None:
        require_bsdf_output(Path(output))
    file = _read(path)
    loaded = load_model(model, library)
    loaded.prepare()
    located = location.locate(loaded, file)
    if output is None:
        return located
    how = f"at latent ({', '.join(located.coordinates)})"
    return _written(located, file, Path(output), how, options)


def reconstruct(
    library: Path | str,
    path: Path | str | MaterialSource,
    output: Path | str,
    *,
    without: Collection[str] = (),
    numbers: int | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> Reconstruction:
    """Reconstruct a measured file from a library, see `manifold.model.location.reconstruct_file`, and write it.

    If `strict` is set, an output whose albedo exceeds 1.05 is not written, and `refusal` states the reason. If the
    output was made physical, the errors refer to the written file.

    Args:
        library: library of measured materials in the same bands, or its path.
        path: the measured file, or another material.
        output: the `.bsdf` file to write.
        without: names of materials that must not be used.
        numbers: largest number of parameters; None sets no limit.
        options: options of the output.

    Raises:
        FileFormatError: the file is not an RGL file.
        BandMismatchError: the file has other bands than the library.
        UsageError: the file is black, no material is left, a name in `without` is unknown, or the output cannot be
            written.
    """
    output = Path(output)
    require_bsdf_output(output)
    file = _read(path)
    reconstruction = location.reconstruct_file(Library(library), file, without, numbers=numbers)
    how = f"from {reconstruction.materials} materials and analytic lobes"
    return _written(reconstruction, file, output, how, options)


def locate_photographs(
    model: Manifold | Path | str,
    request: PhotoRequest,
    output: Path | None = None,
    *,
    library: Path | None = None,
    picture: Path | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> Photographed:
    """Locate photographed balls on a fitted manifold, and write the prediction there.

    `library` is the path of the model's library, if it was moved. `picture` is described in `completions.complete`.
    """
    from manifold.estimate import photographs
    from manifold.estimate.completions import Photographed, notes_of, observe

    start = time.perf_counter()
    if output is not None:
        require_bsdf_output(output)
    if picture is not None:
        photographs.require_drawable(picture, request)
    stages = Stages(
        {"reading pictures": 1, "reading materials": 4, "completing": 3, "expected error": 5, "writing": 2}
        | {"rendering": 3}
    )
    loaded = load_model(model, library)
    material, calibration, balls = observe(loaded.library, stages, pictures=request)
    seen = ClippedBRDF(material.brdf)
    place = location.locate_brdf(loaded, seen)
    notes = (
        *notes_of(material, calibration, balls),
        *place.diagnostics,
        "the expected error and the residual of pixels belong to the material of the pixels; the "
        "reconstruction error compares the prediction at the point with it",
    )
    stages.begin("writing")
    plausibility = None
    with TemporaryDirectory() as folder:
        shown = Path(folder) / "located.bsdf" if output is None else output
        if output is not None or picture is not None:
            written = write_checked(
                shown,
                ClippedBRDF(place.brdf),
                options if output is not None else DEFAULT_OPTIONS,
                description=f"Photographed, at latent ({', '.join(place.coordinates)}), by manifold {__version__}",
            )
            plausibility = written.plausibility
            if written.change is not None and written.file is not None:
                place = replace(place, errors=brdf_errors(seen, MeasuredBRDF(written.file)))
            notes += written.notes
        if picture is not None:
            stages.begin("rendering")
            photographs.draw_residuals(balls, shown, material, request.exposure, picture)
    return Photographed(
        path=output, picture=picture, completion=material, balls=balls, located=place,
        expected=calibration.expected(material),
        plausibility=plausibility, diagnostics=notes, seconds=time.perf_counter() - start,
    )  # fmt: skip


def _read(material: Path | str | MaterialSource) -> BsdfFile:
    return read_source(FileSource(Path(material)) if isinstance(material, str | Path) else material)


def _written(description: _R, source: BsdfFile, output: Path, how: str, options: OutputOptions) -> _R:
    """Write a reconstruction, or refuse it; return it with the plausibility of its file."""
    clipped = ClippedBRDF(description.brdf)
    written = write_output(
        output,
        clipped,
        options,
        description=f"Reconstruction of {source.name} {how} by manifold {__version__}",
    )
    measured = MeasuredBRDF(fill_unmeasured(source))
    if written.change is not None and written.file is not None:
        description = replace(description, errors=brdf_errors(measured, MeasuredBRDF(written.file)))
    before = replace(written.plausibility, negative_share=clipped.clipped_share)
    sentences = (
        *description.diagnostics,
        *diagnostics.of_prediction(False, before, measured=measured),
        *written.projection,
    )
    return replace(
        description, plausibility=written.plausibility, diagnostics=sentences, refusal=written.refusal
    )
