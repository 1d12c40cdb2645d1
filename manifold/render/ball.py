"""Renders of the ball of a material from a file, a fit, or any BRDF."""

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
    """A material as Mitsuba renders it.

    Attributes:
        name: for titles.
        bsdf: dictionary of Mitsuba.
        is_rgb: whether it is linear sRGB, with no spectrum.
        route: in words, how the renderer evaluates it.
    """

    name: str
    bsdf: dict[str, Any]
    is_rgb: bool
    route: str

    def render(self, settings: RenderSettings) -> Array:
        """Render the ball in linear sRGB; see `render_bsdf`."""
        return render_bsdf(self.bsdf, self.is_rgb, settings)


def read_material(path: Path) -> BallMaterial:
    """Read an RGL file, or the JSON of a fit."""
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
            f"{path}: outgoing grid of {rows} x {columns}, expected a square one; Mitsuba reads no other"
        )
    warn_if_invisible(file.bands)
    bsdf = {"type": "measured", "filename": str(path)}
    return BallMaterial(material_name(path), bsdf, file.bands.is_rgb, f"{file.origin} file")


def make_settings(
    *, size: int, samples: int, seed: int, illuminant: str, environment: Path | None
) -> RenderSettings:
    """Make settings with an illuminant by name or file, and an environment from a file."""
    image = None
    if environment is not None:
        try:
            image = lights.exposed(images.read_image(environment))
        except UsageError as error:
            raise UsageError(f"{environment}: {error}") from error
    return RenderSettings(size, samples, seed, parse_illuminant(illuminant), image)


def parse_illuminant(text: str) -> Illuminant:
    """Return a CIE illuminant by its name, or the light of a file of wavelengths and powers."""
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
        material: the path of a `.bsdf` or of a fit, a file that was read, or any BRDF, such as a prediction, which is
            measured by the virtual goniometer first.
        size: pixels per side.
        samples: light paths per pixel.
        seed: fixes the noise.
        illuminant: name of a CIE illuminant, or path of a text file of wavelengths in nm and powers.
        environment: picture of the surroundings, latitude by longitude; a studio by default.

    Raises:
        UsageError: the material has no spectrum, and the light is not D65; or an argument cannot be used.
        FileFormatError: a file is not what it should be.
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
    """Render the ball of a file that was read, or of a BRDF, which is measured first, negative values as 0.

    Returns and raises: as `render_bsdf`.
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
