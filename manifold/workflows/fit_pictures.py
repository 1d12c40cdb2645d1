"""Comparison of a fit and its material in renders: balls, their differences, and slices of both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from manifold.brdf.measured import MeasuredBRDF
from manifold.fitting import fit_json
from manifold.fitting.fitted_brdf import FittedBRDF
from manifold.io_rgl import read_bsdf
from manifold.model import predicted_file
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.latents import Place
from manifold.plots import figures, plot_fit
from manifold.plots.plot_slices import Source
from manifold.rendering import image_metrics, images, scenes
from manifold.rendering.render import RenderSettings, render_bsdf
from manifold.system import temporary
from manifold.workflows.renders import RIM, file_source


@dataclass(frozen=True)
class FitPicture:
    """A picture of a fit beside its material.

    Attributes:
        path: of the picture.
        ciede2000, flip: means over the pixels of the ball.
    """

    path: Path
    ciede2000: float
    flip: float


def picture_of_fit(
    fit: Path, material: Path, output: Path, settings: RenderSettings | None = None
) -> FitPicture:
    """Render a measured file and the BSDF that was fitted to it, and draw both with their slices.

    Args:
        fit: JSON of the fit.
        material: the .bsdf file.
        output: the picture.
        settings: of both renders, by default 256 x 256 pixels under D65, the one light for what has no spectrum.
    Raises:
        UsageError, FileFormatError: a file cannot be used, or the picture not be written.
    """
    figures.require_writable(output)
    settings = RenderSettings() if settings is None else settings
    content = fit_json.read(fit)
    source = file_source(material)
    spectral = None if source.is_rgb else content["mitsuba_spectral"]
    seen = images.tone_map(render_bsdf(source.material, source.is_rgb, settings))
    fitted = images.tone_map(
        render_bsdf(content["mitsuba"] if spectral is None else spectral, spectral is None, settings)
    )
    delta_e, flip = image_metrics.ciede2000_map(seen, fitted), image_metrics.flip_map(seen, fitted)
    inside = scenes.ball_interior(settings.size, RIM)
    file = read_bsdf(material)
    sources = [
        Source(
            "predicted" if file.description.startswith(predicted_file.PREDICTED) else "measured",
            MeasuredBRDF(file),
        ),
        Source(f"fitted: {content['bsdf']['type']}", FittedBRDF(content)),
    ]
    figure = plot_fit.fit_picture(content["source"]["name"], (seen, fitted), delta_e, flip, inside, sources)
    figures.save(figure, output)
    return FitPicture(output, float(delta_e[inside].mean()), float(flip[inside].mean()))


def picture_of_prediction_fit(
    fit: Path, model: Path, latent: Place, output: Path, settings: RenderSettings | None = None, *,
    library: Path | None = None, colour: ColourChoice = NEAREST,
) -> FitPicture:  # fmt: skip
    """The same for a fit of the prediction at a latent, through a file that is written for it."""
    with temporary.folder() as folder:
        path = folder / "predicted.bsdf"
        predicted_file.predict(model, latent, path, library=library, colour=colour, force=True)
        return picture_of_fit(fit, path, output, settings)
