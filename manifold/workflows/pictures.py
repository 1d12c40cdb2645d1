"""One function per command that draws: paths in, a picture out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from manifold.brdf.measured import MeasuredBRDF
from manifold.errors import UsageError
from manifold.fitting import fit_json
from manifold.fitting.fitted_brdf import FittedBRDF
from manifold.io_rgl import read_bsdf
from manifold.model import diagnostics
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.plots import figures, plot_slices
from manifold.plots.plot_slices import Source

KINDS = ("angles", "image", "spectra")


def sources(
    names: Sequence[str],
    latents: Sequence[Place],
    model: Path,
    library: Path | None = None,
    colour: ColourChoice = NEAREST,
) -> list[Source]:
    """BRDFs by file name, by material of the model, and by latent; those of one name are labelled as they were given.

    Args:
        names: paths that end in `.bsdf`, fits that end in `.json`, or names of materials.
        latents: (Q,) each, or names of materials.
        model: opened only where a name or a latent needs it.
        library: where the model's library is now, if not where the model remembers it.
        colour: of the latents, on a monochrome manifold.
    """
    found: list[tuple[str, Source]] = []
    loaded: Manifold | None = None
    for name in names:
        if name.endswith(".bsdf"):
            file = read_bsdf(Path(name))
            found.append((name, Source(file.name, MeasuredBRDF(file))))
        elif name.endswith(".json"):
            content = fit_json.read(Path(name))
            found.append((name, Source(f"{content['source']['name']}, fitted", FittedBRDF(content))))
        else:
            loaded = loaded or Manifold.load(model, library)
            found.append((name, Source(name, loaded.material(name))))
    for latent in latents:
        loaded = loaded or Manifold.load(model, library)
        x, brdf, diagnosis = diagnostics.predict_and_diagnose(loaded, latent, colour)
        at = latent if isinstance(latent, str) else ", ".join(f"{v:.3g}" for v in x)
        found.append((f"predicted at {at}", Source(f"predicted at {at}", brdf, diagnosis)))
    if not found:
        raise UsageError(
            "found nothing to draw; name .bsdf files or materials of the model, or give --latent"
        )
    labels = [source.label for _, source in found]
    return [
        replace(source, label=given) if labels.count(source.label) > 1 else source for given, source in found
    ]


def slices(
    drawn: Sequence[Source], output: Path, *, kind: str = "angles", wavelengths_nm: Sequence[float] = ()
) -> None:
    """Draw slices (`angles`), the Rusinkiewicz plane (`image`) or `spectra` of a few BRDFs.

    Raises:
        UsageError: the kind is unknown, or the picture cannot be written.
    """
    figures.require_writable(output)
    if kind == "angles":
        figure = plot_slices.angle_slices(drawn, wavelengths_nm)
    elif kind == "image":
        figure = plot_slices.rusinkiewicz_images(drawn)
    elif kind == "spectra":
        figure = plot_slices.spectra_at(drawn)
    else:
        raise UsageError(f"no kind of slices is called '{kind}', expected {', '.join(KINDS)}")
    figures.save(figure, output)
