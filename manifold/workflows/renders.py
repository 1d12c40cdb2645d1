"""Pictures: one function per command, paths in, paths and results out.

What a measured file does without (models, fits, figures) is imported where it is used: it takes a second and a half.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import BRDF
from manifold.colour import studio
from manifold.colour.illuminants import Illuminant
from manifold.colour.reflectances import ReflectanceSpectrum
from manifold.errors import UsageError
from manifold.io_rgl import material_name, read_bsdf
from manifold.model.colours import NEAREST, ColourChoice
from manifold.model.latents import Place
from manifold.records import Array, BsdfFile, Progress
from manifold.rendering import backend, image_metrics, images, scenes
from manifold.rendering.image_metrics import Summary
from manifold.rendering.render import RenderSettings, render_bsdf, render_material, require_d65
from manifold.system import temporary

if TYPE_CHECKING:
    from manifold.model.diagnostics import Diagnosis

RIM = 0.03  # of the ball's radius: where it meets the ground, and pixels see both


@dataclass(frozen=True, eq=False)
class Source:
    """The material of the ball.

    Attributes:
        name: for titles.
        material: BSDF as a dictionary of Mitsuba.
        is_rgb: whether it is linear sRGB, with no spectrum.
        route: in words, how the renderer evaluates it.
        diagnosis: of a prediction; None of what was measured or fitted.
    """

    name: str
    material: dict[str, Any]
    is_rgb: bool
    route: str
    diagnosis: Diagnosis | None = None


@dataclass(frozen=True)
class Rendered:
    """A picture that was made.

    Attributes:
        path: of the picture.
        material: name, or the latent.
        route: how the material was evaluated.
        backend: `llvm` or `scalar`.
        advice: how to render faster, where there is something to say.
        illuminant: name of the light.
        size, samples, seed: as asked for.
        seconds: rendering, without reading.
        diagnosis: of a prediction; None of what was measured or fitted.
    """

    path: Path
    material: str
    route: str
    backend: str
    advice: str | None
    illuminant: str
    size: int
    samples: int
    seed: int
    seconds: float
    diagnosis: Diagnosis | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        prediction = None if self.diagnosis is None else self.diagnosis.to_json()
        content = vars(self) | {"path": str(self.path), "prediction": prediction}
        del content["diagnosis"]
        return {"program": f"manifold {__version__}", **content}


def parse_illuminant(text: str) -> Illuminant:
    """A CIE illuminant by its name, or a file of two columns.

    Raises:
        UsageError: there is neither.
        FileFormatError: the file holds no spectrum.
    """
    path = Path(text)
    if path.suffix and path.is_file():
        return Illuminant.read(path)
    if path.suffix.lower() in (".csv", ".txt", ".spd", ".dat") or "/" in text:
        raise UsageError(
            f"{text}: no such file; name a CIE illuminant or a text file of wavelengths and powers"
        )
    return Illuminant.named(text)


def make_settings(
    *, size: int, samples: int, seed: int, illuminant: str, environment: Path | None
) -> RenderSettings:
    """Settings from what a user gives. Raises: as `parse_illuminant` and `images.read_image`."""
    image = None if environment is None else studio.exposed(images.read_image(environment))
    return RenderSettings(size, samples, seed, parse_illuminant(illuminant), image)


def file_source(path: Path) -> Source:
    """A measured file, or the JSON of a fit.

    Raises:
        FileFormatError: it is no RGL file, and no fit.
        UsageError: Mitsuba's `measured` does not take it, or its name.
    """
    if path.suffix == ".json":
        from manifold.fitting import fit_json

        content = fit_json.read(path)
        spectral = content["mitsuba_spectral"]
        material = content["mitsuba"] if spectral is None else spectral
        route = f"fitted {content['bsdf']['type']}"
        return Source(content["source"]["name"] + ", fitted", material, spectral is None, route)
    file = read_bsdf(path)
    rows, columns = file.spectra.shape[3:]
    if rows != columns:
        raise UsageError(
            f"{path}: outgoing grid of {rows} x {columns}, expected a square one; Mitsuba reads no other"
        )
    material = {"type": "measured", "filename": images.mitsuba_path(path)}
    return Source(material_name(path), material, file.bands.is_rgb, "measured file")


@contextmanager
def latent_source(
    model: Path,
    latent: Place,
    *,
    library: Path | None = None,
    colour: ColourChoice = NEAREST,
    direct: bool = False,
    on_progress: Progress | None = None,
) -> Iterator[Source]:
    """The prediction at a latent: through a `.bsdf` that lives as long as the block, or straight from the materials.

    Raises:
        UsageError: `direct` without LLVM or of anisotropic materials; and what `predicted_file.predict` raises.
    """
    name = (
        f"latent {latent}" if isinstance(latent, str) else "latent " + ", ".join(f"{v:.4g}" for v in latent)
    )
    if direct and not backend.choose().is_llvm:
        raise UsageError(
            f"--direct needs Mitsuba's LLVM variants; {backend.INSTALL}, or leave it out: a .bsdf is rendered then"
        )
    from manifold.model import diagnostics, predicted_file
    from manifold.rendering.plugin.bsdf import load_model

    loaded = load_model(model, library)
    if direct and isinstance(colour.reflectance, ReflectanceSpectrum):
        raise UsageError("direct renders take reflectances from a file; name one, or render a predicted file")
    if direct and loaded.space.takes_colours and colour == NEAREST and loaded.path(latent) is not None:
        raise UsageError(
            "direct renders show the colours of latents, not those between two; leave --direct out"
        )
    if direct:
        x, predicted, diagnosis = diagnostics.predict_and_diagnose(loaded, latent, colour)
        if not predicted.is_isotropic:
            raise UsageError(
                "direct renders take isotropic materials, and some of this prediction are anisotropic; "
                "leave --direct out"
            )
        material = {
            "type": "manifold",
            "model": str(model),
            "latent": ",".join(repr(float(v)) for v in x),
        }
        material |= {key: str(value) for key, value in vars(colour).items() if value is not None}
        if library is not None:
            material["library"] = str(library)
        yield Source(name, material, loaded.bands.is_rgb, "measured materials, directly", diagnosis)
        return
    with temporary.folder() as folder:
        path = folder / "predicted.bsdf"
        made = predicted_file.predict(
            loaded, latent, path, colour=colour, force=True, on_progress=on_progress
        )
        source = file_source(path)
        yield Source(name, source.material, source.is_rgb, "predicted file", made.diagnosis)


def render_ball(
    material: Path | str | BsdfFile | BRDF,
    *,
    size: int = 256,
    samples: int = 64,
    seed: int = 0,
    illuminant: str = "D65",
    environment: Path | None = None,
    on_progress: Progress | None = None,
) -> Array:
    """The ball of a material under an environment light: linear sRGB, float64, shape (size, size, 3).

    Args:
        material: the path of a `.bsdf` or of a fit, a file that was read, or any BRDF, such as a prediction, which is
            measured by the virtual goniometer first.
        size: pixels per side.
        samples: light paths per pixel.
        seed: fixes the noise.
        illuminant: name of a CIE illuminant, or path of a text file of wavelengths in nm and powers.
        environment: picture of the surroundings, latitude by longitude; a studio by default.
        on_progress: called with (done, total, what).
    Raises:
        UsageError: the material has no spectrum, and the light is not D65; or an argument cannot be used.
        FileFormatError: a file is not what it should be.
        RendererError: Mitsuba is missing.
    """
    settings = make_settings(
        size=size, samples=samples, seed=seed, illuminant=illuminant, environment=environment
    )
    if not isinstance(material, str | Path):
        return render_material(material, settings, on_progress)
    source = file_source(Path(material))
    return render_bsdf(source.material, source.is_rgb, settings, on_progress)


def render(
    source: Source, output: Path, settings: RenderSettings, on_progress: Progress | None = None
) -> Rendered:
    """Render the material ball into a picture.

    Raises:
        UsageError: the picture cannot be written, or an RGB material meets another light than D65.
    """
    images.require_image_path(output)
    start = time.perf_counter()
    picture = render_bsdf(source.material, source.is_rgb, settings, on_progress)
    seconds = time.perf_counter() - start
    images.write_image(output, picture)
    chosen = backend.choose()
    return Rendered(
        path=output,
        material=source.name,
        route=source.route,
        backend=chosen.kind,
        advice=chosen.advice,
        illuminant=settings.illuminant.name,
        size=settings.size,
        samples=settings.samples,
        seed=settings.seed,
        seconds=seconds,
        diagnosis=source.diagnosis,
    )


@dataclass(frozen=True)
class Comparison:
    """The differences of two pictures.

    Attributes:
        path: of the figure.
        a, b: what was compared.
        ciede2000, itp: over all pixels; Delta E_ITP is that of ITU-R BT.2124.
        flip: over all pixels.
        ciede2000_ball, itp_ball, flip_ball: over the pixels of the ball, where materials were rendered.
    """

    path: Path
    a: str
    b: str
    ciede2000: Summary
    itp: Summary
    flip: Summary
    ciede2000_ball: Summary | None = None
    itp_ball: Summary | None = None
    flip_ball: Summary | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"path": str(self.path)}


def compare(
    a: Path, b: Path, output: Path, settings: RenderSettings, on_progress: Progress | None = None
) -> Comparison:
    """Compare two pictures, or two materials rendered alike.

    Linear pictures are tone-mapped first; that caps what is brighter than a display.

    Raises:
        UsageError: one is a material and the other a picture, or the figure cannot be written.
        ShapeError: the pictures have different sizes.
    """
    from manifold.plots import figures, plot_comparison

    figures.require_writable(output)
    are_materials = [path.suffix in (".bsdf", ".json") for path in (a, b)]
    if any(are_materials) and not all(are_materials):
        raise UsageError(f"{a} and {b}: found a material and a picture, expected two of a kind")
    ball = None
    if all(are_materials):
        sources = [file_source(path) for path in (a, b)]
        if any(source.is_rgb for source in sources):
            require_d65(settings.illuminant)
        pictures = []
        for k, source in enumerate(sources):
            step = None if on_progress is None else _half(on_progress, k, source.name)
            pictures.append(images.tone_map(render_bsdf(source.material, source.is_rgb, settings, step)))
        ball = scenes.ball_interior(settings.size, RIM)
        names = (sources[0].name, sources[1].name)
    else:
        pictures = [images.read_display(path) for path in (a, b)]
        names = (a.name, b.name)
    first, second = pictures
    delta_e, itp = image_metrics.ciede2000_map(first, second), image_metrics.itp_map(first, second)
    flip = image_metrics.flip_map(first, second)
    figures.save(plot_comparison.comparison(first, second, delta_e, flip, names), output)

    def on_ball(values: Array) -> Summary | None:
        return None if ball is None or not np.any(ball) else Summary.of(values[ball])

    return Comparison(
        output, str(a), str(b), *(Summary.of(values) for values in (delta_e, itp, flip)),
        *(on_ball(values) for values in (delta_e, itp, flip)),
    )  # fmt: skip


def _half(on_progress: Progress, k: int, name: str) -> Progress:
    """Progress of the first or the second of two renders."""
    return lambda done, total, _what: on_progress(k * total + done, 2 * total, name)
