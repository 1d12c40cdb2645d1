"""Compares a fit and its material in renderings: balls, their differences, and slices of both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.notebook import ball_image
from manifold.brdf.orientation import aligned
from manifold.core.records import Array, Mask
from manifold.io_rgl import read_bsdf
from manifold.pictures import figures, fit_figure
from manifold.pictures.export_sheet import framed
from manifold.pictures.renders import RIM
from manifold.pictures.slice_figures import ShownBRDF
from manifold.render import fit_json, images, scenes
from manifold.render.ball import read_material, render_material
from manifold.render.fitted_brdf import FittedBRDF
from manifold.render.render import RenderSettings

_PIXELS = 128  # pixels across a ball by quadrature


def picture_of_fit(
    fit: Path, material: Path, output: Path, settings: RenderSettings | None = None
) -> tuple[float, float]:
    """Render a file and the BSDF that was fitted to it, and draw both with their slices.

    Returns the means of CIEDE2000 and FLIP over the ball. By default, renderings have 256 x 256 pixels under D65, the
    only light for materials without a spectrum.
    """
    figures.require_writable(output)
    settings = RenderSettings() if settings is None else settings
    content = fit_json.read(fit)
    file = aligned(read_bsdf(material))
    renders = render_material(file, settings), read_material(fit).render(settings)
    seen, fitted = (images.tone_map(render) for render in renders)
    sources = [
        ShownBRDF(file.origin, MeasuredBRDF(file).turned(np.deg2rad(content.get("rotation_deg", 0.0)))),
        ShownBRDF(f"fitted: {content['bsdf']['type']}", FittedBRDF(content)),
    ]
    inside = scenes.ball_interior(settings.size, RIM)
    return _draw(content["source"]["name"], (seen, fitted), inside, sources, settings.light, output)


def picture_of_brdfs(title: str, sources: Sequence[ShownBRDF], output: Path) -> tuple[float, float]:
    """Draw a material and a substitute for it: balls in the studio, by quadrature, and slices.

    Returns the means of CIEDE2000 and FLIP over the ball.
    """
    balls = [framed(*ball_image(source.brdf, _PIXELS)) for source in sources]
    return _draw(title, (balls[0][0], balls[1][0]), balls[0][1], sources, "studio", output)


def _draw(
    title: str,
    balls: tuple[Array, Array],
    inside: Mask,
    sources: Sequence[ShownBRDF],
    light: str,
    output: Path,
) -> tuple[float, float]:
    """Draw the display pictures of two balls, their differences and slices."""
    delta_e, flip = images.ciede2000_map(*balls), images.flip_map(*balls)
    figures.save(fit_figure.fit_picture(title, balls, delta_e, flip, inside, sources, light), output)
    return float(delta_e[inside].mean()), float(flip[inside].mean())
