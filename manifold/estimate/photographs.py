"""The work behind `--photo` of `manifold complete` and `manifold locate`: photographs of a ball in, a material out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour.conversion import encode_srgb, to_srgb
from manifold.errors import UsageError
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.channels import Channels
from manifold.estimate.completion import Completion
from manifold.estimate.expected import calibrate
from manifold.estimate.gloss import gloss_units
from manifold.estimate.lamp_plan import LampPlan, plan_lamps
from manifold.estimate.lamps import lamp_picture
from manifold.estimate.outlines import Circle
from manifold.estimate.sightings import PhotoRequest, SeenBall, see
from manifold.estimate.solving import CONTRADICTION, Seen
from manifold.formats.readings import Readings
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.model import location
from manifold.model.comparison import brdf_errors
from manifold.model.location import Located
from manifold.model.manifold import Manifold, load_model
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions, require_bsdf_output, write_checked
from manifold.model.prediction import ClippedBRDF
from manifold.names import percent
from manifold.plots import figures
from manifold.progress import Stages
from manifold.records import Array
from manifold.render import images
from manifold.render.render import render_floating_ball
from manifold.results import Result, derived, entry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ODD = 2.0  # least ratio of the error of a picture that contradicts the others to the median one
_MARGIN = 0.05  # width around the ball in pictures of residuals, in radii
_SIZE, _SAMPLES = 256, 32  # pixels a side, and samples per pixel, of predicted pictures
_LARGEST_ERROR = 10.0  # CIEDE2000 of the brightest colour


@dataclass(frozen=True, kw_only=True, eq=False)
class FromPhotographs(Result):
    """A material that was found in photographs.

    Attributes:
        located: its place on a map, where it was asked for.
        output: the file that was written, if any.
        picture: of photographs, predictions and differences, if it was asked for.
        diagnostics: what a user should know before trusting it, in sentences.
        plan: where to hold the lamp next, where that was asked for.
    """

    balls: tuple[SeenBall, ...]
    material: Completion
    expected: Errors[float] = field(
        metadata=entry(row="expected error", words=lambda result: result.expected.words)
    )

    @property
    @derived(
        row="photographs",
        words=lambda result: [
            f"{ball.photograph.path.name}, ball at {ball.circle}"
            + "".join(f", lamp {lamp}" for lamp in ball.lamps)
            + f", residual {100 * residual:.1f} %"
            + ("" if predicted is None else f", {100 * predicted:.1f} % predicted from the others")
            for ball, residual, predicted in result.balls_with_residuals
        ],
    )
    def photographs(self) -> list[dict[str, Any]]:
        """Files with their balls, lamps and residuals."""
        return [
            {
                "path": ball.photograph.path,
                "circle": list(vars(ball.circle).values()),
                "lamps": [lamp.direction for lamp in ball.lamps],
                "residual": residual,
                "predicted": predicted,
            }
            for ball, residual, predicted in self.balls_with_residuals
        ]

    @property
    @derived(
        row="latent", words=lambda result: result.located and ",".join(result.located.coordinates), json=False
    )
    def latent(self) -> Array | None:
        """Its latent on a map, if it was asked for."""
        return None if self.located is None else self.located.latent

    @property
    @derived(
        row="nearest", words=lambda result: [f"{name} ({apart:.2f})" for name, apart in result.nearest], json=False
    )  # fmt: skip
    def nearest(self) -> list[tuple[str, float]]:
        """The nearest materials on the map, with their distances."""
        return [] if self.located is None else self.located.nearest

    located: Located | None = field(
        metadata=entry(row="reconstruction error", words=lambda result: result.located.errors.words)
    )

    @property
    @derived(row="residual of pixels", words=lambda result: f"{100 * result.residual:.1f} % in cube roots")
    def residual(self) -> float:
        """Residual of all pixels, in cube roots."""
        return self.material.residual

    @property
    @derived()
    def exposure(self) -> float:
        """Geometric mean of the exposures."""
        return self.material.exposure

    @property
    @derived(
        row="exposure", words=lambda result: ", ".join(dict.fromkeys(f"{each:.3g}" for each in result.exposures))
    )  # fmt: skip
    def exposures(self) -> Array:
        """Exposures of the pictures."""
        return self.material.exposures

    @property
    @derived(
        row="made of", words=lambda result: [f"{name} {share:.2f}" for name, share in result.made_of.items()]
    )
    def made_of(self) -> dict[str, float]:
        """Shares of materials in the light that the ball sends, by name."""
        return dict(self.material.made_of)

    @property
    @derived()
    def notes(self) -> tuple[str, ...]:
        """Notes on the material."""
        return self.material.notes

    plausibility: Plausibility | None = field(metadata=entry(row="albedo", words="at most {.max_albedo:.2f}"))
    output: Path | None = field(metadata=entry(row="written to"))
    picture: Path | None = field(metadata=entry(row="picture"))

    @property
    @derived()
    def gloss(self) -> dict[str, float]:
        """Gloss units of the written file by angle in degrees; none without a file."""
        if self.output is None:
            return {}
        return {
            f"{angle:g}": units for angle, units in gloss_units(MeasuredBRDF(read_bsdf(self.output))).items()
        }

    diagnostics: tuple[str, ...] = field(metadata=entry())
    seconds: float = field(metadata=entry())
    plan: LampPlan | None = field(default=None, metadata=entry())

    @property
    def balls_with_residuals(self) -> list[tuple[SeenBall, float, float | None]]:
        """The balls, each with the residual of its pixels, and with their error as the other pictures predict them."""
        residuals = self.material.solution.residuals.tolist()
        return list(
            zip(self.balls, residuals, self.material.picture_errors or [None] * len(residuals), strict=True)
        )


def complete(
    library: Path,
    request: PhotoRequest,
    output: Path,
    *,
    readings: Readings | None = None,
    gloss: Mapping[float, float] = MappingProxyType({}),
    picture: Path | None = None,
    count: int = 0,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> FromPhotographs:
    """Find the material of photographed balls, and readings and gloss of it, with a library as prior, and write it.

    Gloss is in units by angle in degrees; `picture` is of photographs, predictions and differences; `count` further
    pictures are suggested.
    """
    start = time.perf_counter()
    require_bsdf_output(output)
    stages = _stages(picture, request)
    balls, material, expected, notes = _found(request, Library(library), readings, gloss, stages)
    stages.begin("writing")
    description = (
        f"Found in {len(balls)} photograph{'s' * (len(balls) > 1)} of a ball through "
        f"{len(material.atoms.names)} materials by manifold {__version__}"
    )
    written = write_checked(
        output,
        ClippedBRDF(material.brdf),
        options,
        description=description,
        remedy="make it physical, check the exposure",
        keeps_hue=True,
    )
    notes += written.notes
    if written.projection:
        notes += ("the residual and expected error are those of the material before it was made physical",)
    if picture is not None:
        stages.begin("rendering")
        draw_residuals(balls, output, material, request.exposure, picture)
    plan = None
    if count:
        stages.begin("suggesting")
        plan = plan_lamps(material.atoms, count, [rows.pixels for rows in material.solution.channels])
    return FromPhotographs(
        balls=balls, material=material, expected=expected, located=None, output=output,
        plausibility=written.plausibility, picture=picture, diagnostics=notes, plan=plan,
        seconds=time.perf_counter() - start,
    )  # fmt: skip


def locate(
    model: Manifold | Path | str,
    request: PhotoRequest,
    output: Path | None = None,
    *,
    library: Path | None = None,
    picture: Path | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> FromPhotographs:
    """Find the place of photographed balls on a fitted manifold, and write the prediction there.

    The library is where it is now, if not where the model remembers it; `picture` is as of `complete`.
    """
    start = time.perf_counter()
    if output is not None:
        require_bsdf_output(output)
    stages = _stages(picture, request)
    loaded = load_model(model, library)
    balls, material, expected, notes = _found(request, loaded.library, None, {}, stages)
    seen = ClippedBRDF(material.brdf)
    place = location.locate_brdf(loaded, seen)
    notes += (
        *place.diagnostics,
        "the expected error and the residual of pixels belong to the material of the pixels; the "
        "reconstruction error compares the prediction at the place with it",
    )
    stages.begin("writing")
    plausibility = None
    with TemporaryDirectory() as folder:
        shown = Path(folder) / "located.bsdf" if output is None else output
        if output is not None or picture is not None:
            written = write_checked(
                shown,
                ClippedBRDF(place.brdf),
                options if output is not None else DEFAULT_OPTIONS,
                description=f"Photographed, at latent ({', '.join(place.coordinates)}), by manifold {__version__}",
            )
            plausibility = written.plausibility
            if written.change is not None and written.file is not None:
                place = replace(place, errors=brdf_errors(seen, MeasuredBRDF(written.file)))
            notes += written.notes
        if picture is not None:
            stages.begin("rendering")
            draw_residuals(balls, shown, material, request.exposure, picture)
    return FromPhotographs(
        balls=balls, material=material, expected=expected, located=place, output=output,
        plausibility=plausibility, picture=picture, diagnostics=notes, seconds=time.perf_counter() - start,
    )  # fmt: skip


def _stages(picture: Path | None, request: PhotoRequest) -> Stages:
    """Return the stages of the work, after a check that its picture can be drawn."""
    if picture is not None:
        figures.require_writable(picture)
        if request.has_cylinder:
            raise UsageError(
                f"{picture}: residuals are drawn of balls, found a cylinder; leave --picture out"
            )
    shares = {
        "reading pictures": 1,
        "reading materials": 4,
        "comparing pixels": 8,
        "writing": 2,
        "rendering": 3,
        "suggesting": 3,
    }
    return Stages(shares)


def _found(
    request: PhotoRequest,
    library: Library,
    readings: Readings | None,
    gloss: Mapping[float, float],
    stages: Stages,
) -> tuple[tuple[SeenBall, ...], Completion, Errors[float], tuple[str, ...]]:
    """Return the balls, the material, its expected errors, and notes."""
    stages.begin("reading pictures")
    balls = see(request)
    stages.begin("reading materials")
    atoms = LibraryAtoms.of_library(library).in_values
    channels = Channels.of_library(library, atoms.names, request.responses)
    stages.begin("comparing pixels")
    seen: list[Seen] = [ball.sighting for ball in balls]
    seen += [] if readings is None else [readings]
    material = Completion.of(
        atoms, [*seen, gloss], exposure=request.exposure, each=request.each, channels=channels
    )  # fmt: skip
    calibration = calibrate(atoms, material.exposed, library)
    notes = [
        *(note for ball in balls for note in ball.notes),
        *calibration.notes(material),
        *material.notes,
        *_odd_pictures([ball.photograph.path.name for ball in balls], material.picture_errors),
    ]
    return balls, material, calibration.expected(material), tuple(dict.fromkeys(notes))


def _odd_pictures(names: Sequence[str], predicted: Sequence[float]) -> list[str]:
    """Return a sentence on each photograph that contradicts the others, by its error as these predict it.

    Of two, one says too little of sparkling materials in the light of the other.
    """
    if len(predicted) <= 2:
        return []
    usual = float(np.median(predicted))
    return [
        f"{name}: cube roots differ by {percent(error)} if the other pictures predict them, which contradict it: check "
        "that it shows the same material, its lamp and its outline"
        for name, error in zip(names, predicted, strict=False)
        if error > max(CONTRADICTION, _ODD * usual)
    ]


def draw_residuals(
    balls: Sequence[SeenBall], file: Path, material: Completion, exposure: float | None, picture: Path
) -> None:
    """Draw photographs beside renders of a file, with their differences.

    A known exposure is divided out; with one that was estimated, photographs stay as they are, and renders are exposed
    alike: else a wrong one would make all white, or black, and differences small.
    """
    known = exposure or 1.0
    seen, predicted, errors = [], [], []
    for ball, of_picture in zip(balls, material.exposures.tolist(), strict=True):
        crop = _cropped(ball.photograph.values, ball.circle) / known
        clipped = (
            _cropped(ball.photograph.is_clipped[..., None].astype(np.float32), ball.circle)[..., 0] > 0.0
        )
        camera = ball.sighting.camera
        if ball.light is None:
            brdf = MeasuredBRDF(read_bsdf(file))
            lit = lamp_picture(brdf, camera, ball.lamps, _SIZE, _MARGIN)
            made = lit if brdf.bands.is_rgb else to_srgb(lit, brdf.bands)
        else:
            made = render_floating_ball(
                file, material.bands.is_rgb, ball.light, size=_SIZE, samples=_SAMPLES, margin=_MARGIN,
                turn_deg=camera.turn_deg, elevation_deg=camera.elevation_deg, distance=camera.distance,
            )  # fmt: skip
        made = made * (of_picture / known)
        shown = [encode_srgb(np.nan_to_num(each)) for each in (crop, made)]
        across = (1.0 + _MARGIN) * (2.0 * (np.arange(_SIZE) + 0.5) / _SIZE - 1.0)
        compared = np.hypot(across, across[:, None]) < 0.97
        compared &= np.isfinite(crop).all(axis=2) & ~clipped
        seen.append(crop)
        predicted.append(made)
        errors.append(np.where(compared, images.ciede2000_map(*shown), np.nan))
    names = [ball.photograph.path.name for ball in balls]
    figures.save(residual_figure(names, seen, predicted, errors), picture)


def _cropped(values: Array, circle: Circle) -> Array:
    """Return the square around a circle, nearest pixels, NaN beyond the picture: shape (_SIZE, _SIZE, C)."""
    across = (1.0 + _MARGIN) * circle.radius * (2.0 * (np.arange(_SIZE) + 0.5) / _SIZE - 1.0)
    rows, columns = (np.floor(centre + across).astype(int) for centre in (circle.y, circle.x))
    inside = [(at >= 0) & (at < n) for at, n in zip((rows, columns), values.shape, strict=False)]
    picked = values[np.clip(rows, 0, values.shape[0] - 1)[:, None], np.clip(columns, 0, values.shape[1] - 1)]
    return np.where((inside[0][:, None] & inside[1])[..., None], picked, np.nan)


def residual_figure(
    names: Sequence[str], seen: Sequence[Array], predicted: Sequence[Array], errors: Sequence[Array]
) -> Figure:
    """Draw a row for every photograph: the photograph, its prediction, and the difference.

    The first two are linear sRGB (H, W, 3); errors are CIEDE2000, NaN where nothing was compared, (H, W).
    """
    figure = figures.new_figure(9.0, 3.1 * len(names))
    axes = figure.subplots(len(names), 3, squeeze=False)
    for row, name, photograph, prediction, error in zip(axes, names, seen, predicted, errors, strict=True):
        for axis, picture in zip(row[:2], (photograph, prediction), strict=True):
            axis.imshow(encode_srgb(np.nan_to_num(picture)), interpolation="nearest")
        shown = row[2].imshow(error, cmap="magma", vmin=0.0, vmax=_LARGEST_ERROR, interpolation="nearest")
        figure.colorbar(shown, ax=row[2], shrink=0.8, extend="max")
        difference = f"CIEDE2000 in this light, mean {np.nanmean(error):.1f}"
        titles = figures.in_lines(name), "predicted", difference
        for axis, title in zip(row, titles, strict=True):
            axis.set_title(title, fontsize=9)
            axis.set_axis_off()
    return figure
