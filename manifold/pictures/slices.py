"""One function per command that draws: paths in, a picture out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import blank_unmeasured
from manifold.errors import UsageError
from manifold.estimate.sources import FileSource, MaterialSource, PlaceSource, read_source
from manifold.model import diagnostics
from manifold.model.manifold import Manifold
from manifold.plots import figures, slice_figures
from manifold.plots.slice_figures import Source
from manifold.render import fit_json
from manifold.render.fitted_brdf import FittedBRDF

SliceKind = Literal["angles", "image", "spectra"]


def sources(materials: Sequence[MaterialSource]) -> list[Source]:
    """BRDFs of what a user names; those of one label are labelled as they were given.

    Those that were measured are NaN where they were not measured. Each model is opened once.
    """
    found: list[tuple[str, Source]] = []
    models: dict[tuple[Path, Path | None], Manifold] = {}
    for material in materials:
        given = str(material)
        if isinstance(material, PlaceSource):
            key = (material.model, material.library)
            if key not in models:
                models[key] = Manifold.load(*key)
            made = diagnostics.predict_and_diagnose(models[key], material.place, material.colour)
            found.append((f"predicted at {given}", Source(f"predicted at {given}", made.brdf, made)))
        elif isinstance(material, FileSource) and material.path.suffix == ".json":
            content = fit_json.read(material.path)
            found.append((given, Source(f"{content['source']['name']}, fitted", FittedBRDF(content))))
        else:
            file = read_source(material)
            is_told = file.origin in ("measured", file.name)
            label = file.name if is_told else f"{file.name}, {file.origin}"
            found.append((given, Source(label, MeasuredBRDF(blank_unmeasured(file)))))
    if not found:
        raise UsageError("found nothing to draw; name files, materials of a library, or places on a map")
    labels = [source.label for _, source in found]
    return [
        replace(source, label=given) if labels.count(source.label) > 1 else source for given, source in found
    ]


def slices(
    drawn: Sequence[Source], output: Path, *, kind: SliceKind = "angles", wavelengths_nm: Sequence[float] = ()
) -> None:
    """Draw slices (`angles`), the Rusinkiewicz plane (`image`) or `spectra` of a few BRDFs.

    Raises:
        UsageError: the picture cannot be written.
    """
    figures.require_writable(output)
    if kind == "angles":
        figure = slice_figures.angle_slices(drawn, wavelengths_nm)
    elif kind == "image":
        figure = slice_figures.rusinkiewicz_images(drawn)
    else:
        figure = slice_figures.spectra_at(drawn)
    figures.save(figure, output)
