"""The work behind `manifold locate` and `manifold reconstruct`: a measured file in, its reconstruction out."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from manifold import __version__
from manifold.io_rgl import material_name, read_bsdf
from manifold.library.store import Library
from manifold.model import diagnostics, located
from manifold.model.located import Located, Reconstruction
from manifold.model.manifold import Manifold
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions
from manifold.model.prediction import ClippedBRDF
from manifold.records import Progress
from manifold.workflows.output_files import require_bsdf_output, write_checked

_R = TypeVar("_R", bound=Reconstruction)


def locate(
    model: Manifold | Path | str,
    path: Path | str,
    output: Path | str | None = None,
    *,
    library: Path | str | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
    on_progress: Progress | None = None,
) -> Located:
    """Embed a measured file in a fitted manifold, see `manifold.model.located.locate`.

    Args:
        model: a fitted manifold, or the path of one.
        path: the measured file.
        output: a `.bsdf` file for the prediction at the latent, in the colours found; None writes none.
        library: where the model's library is now, if not where the model remembers it.
        options: of the output.
        on_progress: called with (done, total, what) while materials are read.
    Raises:
        FileFormatError: the file is no RGL file.
        BandMismatchError: its bands are not the library's.
        UsageError: the output cannot be written, or its albedo would exceed 1.05 and `force` is not set.
    """
    if output is not None:
        require_bsdf_output(Path(output))
    file = read_bsdf(path)
    loaded = model if isinstance(model, Manifold) else Manifold.load(model, library)
    loaded.prepare(on_progress)
    found = located.locate(loaded, file)
    if output is None:
        return found
    how = f"at latent ({', '.join(found.coordinates)})"
    return _written(found, Path(path), Path(output), how, options)


def reconstruct(
    library: Path | str,
    path: Path | str,
    output: Path | str,
    *,
    without: Collection[str] = (),
    numbers: int | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
    on_progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct a measured file from a library, see `manifold.model.located.reconstruct_file`, and write it.

    Args:
        library: of measured materials in the same bands.
        path: the measured file.
        output: the `.bsdf` file to write.
        without: names of materials that take no part.
        numbers: that may describe the file; by default as many as it takes.
        options: of the output.
        on_progress: called with (done, total, what) while materials are read.
    Raises:
        FileFormatError: the file is no RGL file.
        BandMismatchError: its bands are not the library's.
        UsageError: the file is black, no material is left, there is none of a name in `without`, the output cannot be
            written, or its albedo would exceed 1.05 and `force` is not set.
    """
    output = Path(output)
    require_bsdf_output(output)
    found = located.reconstruct_file(Library(library), read_bsdf(path), without, on_progress, numbers=numbers)
    how = f"from {found.materials} materials and analytic lobes"
    return _written(found, Path(path), output, how, options)


def _written(found: _R, path: Path, output: Path, how: str, options: OutputOptions) -> _R:
    """A reconstruction of the file at `path` that is written, with the plausibility of its file."""
    plausibility = write_checked(
        output,
        ClippedBRDF(found.brdf),
        options,
        description=f"Reconstruction of {material_name(path)} {how} by manifold {__version__}",
    )
    sentences = (*found.diagnostics, *diagnostics.of_prediction(False, plausibility))
    if options.physical:
        sentences += diagnostics.of_projection(plausibility)
    return replace(found, plausibility=plausibility, diagnostics=sentences)
