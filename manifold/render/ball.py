"""Renders the material ball of a file, a fit, or any BRDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF, require_brdf
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour import lights
from manifold.colour.conversion import warn_if_invisible
from manifold.colour.illuminants import Illuminant
from manifold.core.errors import MissingFileError, UsageError
from manifold.core.records import Array, BsdfFile
from manifold.formats.recognition import is_fit
from manifold.formats.tensor_file import is_compressed
from manifold.io_rgl import material_name, read_bsdf, write_bsdf
from manifold.model.prediction import ClippedBRDF
from manifold.render import images
from manifold.render.render import RenderSettings, render_bsdf


@dataclass(frozen=True, eq=False)
class BallMaterial:
    """A material in the form in which Mitsuba renders it.

    Attributes:
        name: name for titles.
        bsdf: the BSDF as a Mitsuba dictionary.
        is_rgb: whether the material is linear sRGB, without a spectrum.
        route: text that says how the renderer evaluates the material.
    """

    name: str
    bsdf: dict[str, Any]
    is_rgb: bool
    route: str

    def render(self, settings: RenderSettings) -> Array:
        """Render the ball in linear sRGB, see `render_bsdf`."""
        return render_bsdf(self.bsdf, self.is_rgb, settings)


def read_material(path: Path) -> BallMaterial:
    """Read a material to be rendered: an RGL file, or the JSON of a fit."""
    if path.suffix == ".json" or is_fit(path):
        from manifold.render import fit_json

        content = fit_json.read(path)
        spectral = content["mitsuba_spectral"]
        bsdf = content["mitsuba"] if spectral is None else spectral
        route = f"fitted {content['bsdf']['type']}"
        return BallMaterial(content["source"]["name"] + ", fitted", bsdf, spectral is None, route)
    file = read_bsdf(path)
    rows, columns = file.spectra.shape[3:]
    if rows != columns:
        raise UsageError(
            f"{path}: outgoing grid of {rows} x {columns}, expected a square grid, which Mitsuba requires"
        )
    warn_if_invisible(file.bands)
    bsdf = {"type": "measured", "filename": str(path)}
    return BallMaterial(material_name(path), bsdf, file.bands.is_rgb, f"{file.origin} file")


def make_settings(
    *,
    size: int,
    samples: int,
    seed: int,
    illuminant: str,
    environment: Path | None,
    is_linear: bool | None = None,
) -> RenderSettings:
    """Return render settings, given the name or file of an illuminant, and the file of an environment.

    `is_linear` says whether the environment's values are linear; by default as its file says.
    """
    image = None
    if environment is not None:
        radiance = images.read_image(environment, is_linear)
        try:
            image = lights.exposed(radiance)
        except UsageError as error:
            raise UsageError(f"{environment}: {error}") from error
    return RenderSettings(size, samples, seed, parse_illuminant(illuminant), image)


def parse_illuminant(text: str) -> Illuminant:
    """Return the CIE illuminant with a name, or the light in a file of wavelengths and powers."""
    path = Path(text)
    if path.suffix and path.is_file():
        return Illuminant.read(path)
    if path.suffix.lower() in (".csv", ".txt", ".spd", ".dat", ".sed", ".sp", ".spdx") or "/" in text:
        raise MissingFileError(
            f"{text}: no such file; name a CIE illuminant or a text file of wavelengths and powers"
        )
    return Illuminant.named(text)


def render_ball(
    material: Path | str | BsdfFile | BRDF,
    *,
    size: int = 256,
    samples: int = 64,
    seed: int = 0,
    illuminant: str = "D65",
    environment: Path | None = None,
) -> Array:
    """Render the ball of a material under an environment light: linear sRGB, float64, shape (size, size, 3).

    Args:
        material: path of a `.bsdf` file or of a fit, a `BsdfFile`, or any BRDF, such as a prediction, which the
            virtual goniometer measures first.
        size: pixels per side.
        samples: light paths per pixel.
        seed: seed of the noise.
        illuminant: name of a CIE illuminant, or path of a text file of wavelengths in nm and powers.
        environment: picture of the surroundings by latitude and longitude; by default a studio.

    Raises:
        UsageError: the material has no spectrum and the light is not D65, or an argument is out of range.
        FileFormatError: a file has the wrong format, or is damaged.
        RendererError: Mitsuba is missing.
    """
    settings = make_settings(
        size=size, samples=samples, seed=seed, illuminant=illuminant, environment=environment
    )
    if isinstance(material, str | Path):
        path = Path(material)
        if is_compressed(path):  # which Mitsuba does not open
            return render_material(read_bsdf(path), settings)
        return read_material(path).render(settings)
    return render_material(material, settings)


def render_material(material: BRDF | BsdfFile, settings: RenderSettings) -> Array:
    """Render the ball of a `BsdfFile`, or of a BRDF, which the virtual goniometer measures first.

    Negative values are rendered as 0. Returns linear sRGB, shape (size, size, 3), and raises as `render_bsdf`.
    """
    if isinstance(material, BsdfFile) and material.rotation_rad:
        material = MeasuredBRDF(material)  # Mitsuba knows no rotation of a file
    if not isinstance(material, BsdfFile):
        require_brdf(material, "the material to render")
        version = (1, 0) if material.bands.is_rgb else (3, 1)
        material = goniometer.measure(ClippedBRDF(material), "material", version=version)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "material.bsdf"
        write_bsdf(path, material)
        return read_material(path).render(settings)
