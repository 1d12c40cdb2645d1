"""Makes the pictures of `manifold render` and `manifold compare`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold import __version__
from manifold.colour.conversion import warn_if_invisible
from manifold.colour.picture_files import notes_together, read_picture
from manifold.colour.reflectances import ReflectanceSpectrum
from manifold.core import shipped
from manifold.core.errors import UsageError
from manifold.core.progress import Stages
from manifold.core.results import Result, entry
from manifold.estimate.source_files import source_file
from manifold.estimate.sources import FileSource, MaterialSource, PlaceSource
from manifold.formats.recognition import Kind, kind_of
from manifold.library.identity import hash_arrays
from manifold.model.colours import ColourChoice
from manifold.model.places import PlaceLike
from manifold.render import backend, images, scenes
from manifold.render.ball import BallMaterial, read_material
from manifold.render.images import Summary
from manifold.render.render import RenderSettings, require_d65

if TYPE_CHECKING:
    from manifold.model.diagnostics import DiagnosedPrediction

# What a measured file does without (models, predictions, figures) is imported where it is used: it takes 1.5 s.

RIM = 0.03  # share of the ball's radius: where it meets the ground, and pixels see both


@dataclass(frozen=True, kw_only=True)
class Rendered(Result):
    """The result of `render`: the file and how it was rendered.

    Attributes:
        route: text that says how Mitsuba evaluates the material.
        seconds: time of rendering, without reading.
        prediction: the rendered prediction; None for measured and fitted materials.
    """

    program: str = field(default=f"manifold {__version__}", metadata=entry())
    path: Path = field(metadata=entry())
    material: str = field(
        metadata=entry(row="material", words=lambda made: f"{made.material} ({made.route})")
    )
    route: str = field(metadata=entry(columns={"material": ()}))
    illuminant: str = field(metadata=entry(row="light", columns={"light": ()}))
    size: int = field(
        metadata=entry(
            row="picture",
            words=lambda made: (
                f"{made.size} x {made.size}, {made.samples} samples per pixel, seed {made.seed}"
            ),
        )
    )
    samples: int = field(metadata=entry())
    seed: int = field(metadata=entry())
    backend: str = field(metadata=entry(row="renderer"))
    advice: str | None = field(metadata=entry())
    seconds: float = field(metadata=entry(row="time", words="{:.1f}", unit="s"))
    prediction: DiagnosedPrediction | None = field(metadata=entry())

    @property
    def rows(self) -> dict[str, object]:
        """Return the rows of the table, by label; those of the prediction come last, with its diagnostics."""
        made = self.prediction
        of_prediction = {} if made is None else made.summary | {"diagnostics": made.diagnostics}
        return super().rows | {label: words for label, words in of_prediction.items() if words}


def settings_key(settings: RenderSettings) -> dict[str, Any]:
    """Return the settings that a picture depends on, as plain values."""
    light = settings.illuminant
    arrays = {"wavelengths_nm": np.array(light.wavelengths_nm), "power": np.array(light.power)}
    if settings.environment is not None:
        arrays["environment"] = settings.environment
    return {
        "size": settings.size, "samples": settings.samples, "seed": settings.seed, "backend": backend.choose().kind,
        "light": hash_arrays(arrays),
    }  # fmt: skip


def render(
    source: MaterialSource, output: Path, settings: RenderSettings | None = None, *, direct: bool = False,
    ) -> Rendered:  # fmt: skip
    """Render the ball of a material into a picture file.

    Args:
        source: an RGL file, the JSON of a fit, a material of a library, or a point; see `ball_material`.
        output: the picture.
        settings: settings of the render.
        direct: evaluate the measured materials of a prediction while rendering.

    Raises:
        UsageError: the picture cannot be written, an RGB material is rendered under a light other than D65, or
            `direct` is set for a material that is not a point on a map.
        FileFormatError: the file is neither an RGL file nor a fit.
    """
    images.require_image_path(output)
    settings = settings or RenderSettings()
    stages = Stages({"": 1, "rendering": 1})
    stages.begin("")
    with ball_material(source, direct=direct) as (material, made):
        stages.begin("rendering")
        start = time.perf_counter()
        picture = material.render(settings)
        seconds = time.perf_counter() - start
    images.write_image(output, picture)
    renderer = backend.choose()
    return Rendered(
        path=output, material=material.name, route=material.route, illuminant=settings.illuminant.name,
        size=settings.size, samples=settings.samples, seed=settings.seed, backend=renderer.kind,
        advice=renderer.advice, seconds=seconds, prediction=made,
    )  # fmt: skip


@contextmanager
def ball_material(
    source: MaterialSource,
    *,
    direct: bool = False,
) -> Iterator[tuple[BallMaterial, DiagnosedPrediction | None]]:
    """Yield a material to be rendered, and its prediction; files written for it exist during the block."""
    if isinstance(source, PlaceSource):
        predicted = latent_material(
            source.model, source.place, library=source.library, colour=source.colour, direct=direct,
        )  # fmt: skip
        with predicted as made:
            yield made
        return
    if direct:
        raise UsageError(f"{source}: --direct evaluates predictions; leave it out to render a file")
    with source_file(source) as path:
        yield read_material(path), None


@contextmanager
def latent_material(
    model: Path, latent: PlaceLike, *, library: Path | None, colour: ColourChoice, direct: bool
) -> Iterator[tuple[BallMaterial, DiagnosedPrediction]]:
    """Yield the prediction at a latent for rendering: as a temporary `.bsdf` file, or with `direct` as a plugin."""
    from manifold.estimate import predictions
    from manifold.model import diagnostics
    from manifold.model.manifold import load_model
    from manifold.model.output_file import FINE_OPTIONS

    at = PlaceSource(model, latent)
    if not direct:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "predicted.bsdf"
            loaded = load_model(model, library)
            made = predictions.predict(loaded, latent, path, colour=colour, options=FINE_OPTIONS)
            file = read_material(path)
            yield BallMaterial(f"latent {at}", file.bsdf, file.is_rgb, "predicted file"), made
        return
    if not backend.choose().is_llvm:
        raise UsageError(f"--direct needs Mitsuba's LLVM variants; {backend.INSTALL}, or leave it out")
    if isinstance(colour.reflectance, ReflectanceSpectrum):
        raise UsageError("--direct takes reflectances only from a file; name one, or leave --direct out")
    loaded = load_model(model, library)
    warn_if_invisible(loaded.bands)
    predicted = diagnostics.predict_and_diagnose(loaded, latent, colour)
    if predicted.latent is None:
        raise UsageError(f"{at}: --direct cannot evaluate a step of a walk; leave it out")
    coordinates = ",".join(repr(float(v)) for v in predicted.latent)
    bsdf = {"type": "manifold", "model": shipped.named(model), "latent": coordinates}
    bsdf |= {key: str(value) for key, value in vars(colour).items() if value is not None}
    if library is not None:
        bsdf["library"] = shipped.named(library)
    yield BallMaterial(f"latent {at}", bsdf, loaded.bands.is_rgb, "measured materials, directly"), predicted


@dataclass(frozen=True, kw_only=True)
class Comparison(Result):
    """The differences of two pictures, or of two materials.

    Attributes:
        path: path of the figure.
        a, b: names of the compared pictures or materials.
        light: name of the light of the renderings.
        ciede2000_ball, itp_ball, flip_ball: means over the pixels of the ball; None if pictures were compared.
        ciede2000, itp, flip: means over all pixels; `itp` is Delta E_ITP of ITU-R BT.2124.
        diagnostics: diagnostics of compared predictions.
    """

    path: Path = field(metadata=entry())
    a: str = field(metadata=entry())
    b: str = field(metadata=entry())
    light: str = field(metadata=entry(row="light"))
    ciede2000_ball: Summary | None = field(default=None, metadata=entry(row="CIEDE2000 of the ball"))
    ciede2000: Summary = field(metadata=entry(row="CIEDE2000 of the picture"))
    itp_ball: Summary | None = field(default=None, metadata=entry(row="Delta E_ITP of the ball"))
    itp: Summary = field(metadata=entry(row="Delta E_ITP of the picture"))
    flip_ball: Summary | None = field(default=None, metadata=entry(row="FLIP of the ball"))
    flip: Summary = field(metadata=entry(row="FLIP of the picture"))
    diagnostics: tuple[str, ...] = field(metadata=entry(row="diagnostics"))


def compare(
    a: MaterialSource, b: MaterialSource, output: Path, settings: RenderSettings, *, is_linear: bool | None = None,
) -> Comparison:  # fmt: skip
    """Compare two pictures, or the renders of two materials, and draw maps of their difference.

    Linear pictures are tone-mapped first, so values brighter than the display are compressed. `is_linear` says whether
    pictures are linear or encoded; by default the files decide.

    Raises:
        UsageError: one is a material and the other a picture, or the figure cannot be written.
        ShapeError: the pictures have different sizes.
    """
    from manifold.pictures import comparison_figure, figures

    figures.require_writable(output)
    pictures = [
        source.path
        for source in (a, b)
        if isinstance(source, FileSource) and kind_of(source.path) is Kind.PICTURE
    ]
    if len(pictures) == 1:
        raise UsageError(
            f"{a} and {b}: found a material and a picture, expected two materials or two pictures"
        )
    ball = None
    diagnostics: list[str] = []
    if pictures:
        read = [read_picture(path, is_linear) for path in pictures]
        first, second = (images.as_display(picture) for picture in read)
        diagnostics += notes_together((one.path.name, one.notes) for one in read if one.is_guessed)
        names = (pictures[0].name, pictures[1].name)
    else:
        stages = Stages({"": 1, "rendering": 2, "rendering the other": 2})
        stages.begin("")
        with ball_material(a) as (one, prediction), ball_material(b) as (other, other_prediction):
            for source, shown in ((a, prediction), (b, other_prediction)):
                diagnostics += [f"{source}: {said}" for said in (shown.diagnostics if shown else ())]
            if one.is_rgb or other.is_rgb:
                require_d65(settings.illuminant)
            stages.begin("rendering")
            first = images.tone_map(one.render(settings))
            stages.begin("rendering the other")
            second = images.tone_map(other.render(settings))
        names = (one.name, other.name)
        ball = scenes.ball_interior(settings.size, RIM)
    maps = {
        "ciede2000": images.ciede2000_map(first, second),
        "itp": images.itp_map(first, second),
        "flip": images.flip_map(first, second),
    }
    light = "as displayed" if ball is None else settings.light
    drawn = comparison_figure.comparison(first, second, maps["ciede2000"], maps["flip"], names, light, ball)
    figures.save(drawn, output)
    differences = {key: Summary.of(values) for key, values in maps.items()}
    if ball is not None:
        differences |= {f"{key}_ball": Summary.of(values[ball]) for key, values in maps.items()}
    return Comparison(
        path=output, a=str(a), b=str(b), light=light, diagnostics=tuple(diagnostics), **differences
    )
