"""One function per command that draws: paths in, a picture out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import blank_unmeasured
from manifold.errors import UsageError
from manifold.fitting import fit_json
from manifold.fitting.fitted_brdf import FittedBRDF
from manifold.io_rgl import read_bsdf
from manifold.model import diagnostics
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.latents import PlaceLike
from manifold.model.manifold import Manifold
from manifold.plots import figures, plot_slices
from manifold.plots.plot_slices import Source

SliceKind = Literal["angles", "image", "spectra"]


def sources(
    names: Sequence[str],
    latents: Sequence[PlaceLike],
    model: Path,
    library: Path | None = None,
    colour: ColourChoice = NEAREST,
) -> list[Source]:
    """BRDFs by file name, by material of the model, and by latent; those of one name are labelled as they were given.

    Those that were measured are NaN where they were not measured.

    Args:
        names: paths that end in `.bsdf`, fits that end in `.json`, or names of materials.
        latents: (Q,) each, or names of materials.
        model: opened only where a name or a latent needs it.
        library: path of the model's library, if it was moved.
        colour: of the latents, on a monochrome manifold.
    """
    found: list[tuple[str, Source]] = []
    loaded: Manifold | None = None
    for name in names:
        if name.endswith(".bsdf"):
            file = read_bsdf(Path(name))
            found.append((name, Source(file.name, MeasuredBRDF(blank_unmeasured(file)))))
        elif name.endswith(".json"):
            content = fit_json.read(Path(name))
            found.append((name, Source(f"{content['source']['name']}, fitted", FittedBRDF(content))))
        else:
            loaded = loaded or Manifold.load(model, library)
            loaded.material(name)  # refuses what is no material of the model
            found.append((name, Source(name, MeasuredBRDF(blank_unmeasured(loaded.library.read(name))))))
    for latent in latents:
        loaded = loaded or Manifold.load(model, library)
        made = diagnostics.predict(loaded, latent, colour)
        at = latent if isinstance(latent, str) else ", ".join(f"{v:.3g}" for v in made.latent)
        found.append((f"predicted at {at}", Source(f"predicted at {at}", made.brdf, made)))
    if not found:
        raise UsageError("found nothing to draw; name .bsdf files or materials or latents of the model")
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
        figure = plot_slices.angle_slices(drawn, wavelengths_nm)
    elif kind == "image":
        figure = plot_slices.rusinkiewicz_images(drawn)
    else:
        figure = plot_slices.spectra_at(drawn)
    figures.save(figure, output)
