"""The work behind `--photo` of `manifold complete` and `manifold locate`: photographs of a ball in, a material out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour.conversion import encode_srgb, interpolation_matrix, to_srgb, xyz_to_srgb, xyz_weights
from manifold.colour.illuminants import Illuminant
from manifold.colour.reflectances import diffuse_reflectance, diffuse_reflectance_names
from manifold.directions import from_spherical
from manifold.errors import BandMismatchError, FileFormatError, UsageError
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.completion import bands_of, for_library, in_channels, without_gaps
from manifold.estimate.gloss import gloss_units
from manifold.estimate.lamp_plan import LampPlan, plan_lamps
from manifold.estimate.lamps import lamp_picture
from manifold.estimate.outlines import Circle
from manifold.estimate.photo_material import CONTRADICTION, PhotoMaterial, Seen, find_material
from manifold.estimate.sightings import PhotoRequest, SeenBall, see
from manifold.formats.readings import Readings
from manifold.formats.spectra import read_spectrum
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.metrics import Errors
from manifold.model import location
from manifold.model.comparison import brdf_errors
from manifold.model.location import Located
from manifold.model.manifold import Manifold, load_model
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions, require_bsdf_output, write_checked
from manifold.model.prediction import ClippedBRDF
from manifold.plots import figures
from manifold.progress import Stages
from manifold.records import Array, Bands
from manifold.render import images
from manifold.render.render import render_floating_ball
from manifold.results import Result, derived, entry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ODD = 2.0  # least ratio of the error of a picture that contradicts the others to the median one
_MARGIN = 0.05  # width around the ball in pictures of residuals, in radii
_SIZE, _SAMPLES = 256, 32  # pixels a side, and samples per pixel, of predicted pictures
_NOISE = 0.02  # standard deviation of channels, relative to their mean
_UNLIKE = 0.1  # standard deviation of how a material's matrix from channels to bands differs from the prior's
_STEP_NM = 5.0
_VIEWS_DEG = ((45.0, 0.0), (30.0, -50.0), (60.0, 10.0))  # incidence and viewing elevation, off the highlight
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
    material: PhotoMaterial

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
    @derived(row="expected error", words=lambda result: result.expected.words)
    def expected(self) -> Errors[float]:
        """Expected errors."""
        return self.material.expected

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
            zip(self.balls, residuals, self.material.predicted or [None] * len(residuals), strict=True)
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
    balls, material, notes = _found(request, Library(library), readings, gloss, stages)
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
        plan = plan_lamps(material.atoms, count, [rows.pixels for rows in material.channels])
    return FromPhotographs(
        balls=balls, material=material, located=None, output=output, plausibility=written.plausibility, picture=picture,
        diagnostics=notes, seconds=time.perf_counter() - start, plan=plan,
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
    balls, material, notes = _found(request, loaded.library, None, {}, stages)
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
        balls=balls, material=material, located=place, output=output, plausibility=plausibility, picture=picture,
        diagnostics=notes, seconds=time.perf_counter() - start,
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
) -> tuple[tuple[SeenBall, ...], PhotoMaterial, tuple[str, ...]]:
    """Return the observations, the material, and notes."""
    stages.begin("reading pictures")
    balls = see(request)
    responses = (
        srgb_responses(library.bands)
        if request.responses is None
        else read_responses(request.responses, library.bands)
    )
    stages.begin("reading materials")
    atoms = LibraryAtoms.of_library(library).in_values
    stages.begin("comparing pixels")
    seen: list[Seen] = [ball.sighting for ball in balls]
    bands, to_bands = library.bands, band_matrix(library, atoms.names, responses)
    if readings is not None:
        readings = for_library(readings, library.bands)
        bands = bands_of(readings, library.bands)
        channels, to_bands = matrix_of_readings(readings, library.bands, responses, to_bands)
        seen.append(channels)
    if gloss:
        seen.append(gloss)
    material = find_material(
        atoms, seen, to_bands,
        exposure=request.exposure, each=request.each, bands=bands, library=library,
    )  # fmt: skip
    notes = [note for ball in balls for note in ball.notes] + list(material.notes)
    if request.exposure is None and readings is None:
        notes.append(
            "the exposure was estimated from how bright the library's materials are: lightness may be off by a factor "
            "of two and more, which the expected errors include; a grey card in the picture (--grey) fixes it"
        )
    if readings is not None:
        notes += readings.notes
    notes += _agreement(material, readings, gloss)
    notes += _odd_pictures([ball.photograph.path.name for ball in balls], material.predicted)
    if readings is not None and not readings.bands.is_rgb:
        notes.append(
            "spectra follow the readings; photographs determine how three channels change with direction"
        )
    elif not library.bands.is_rgb:
        notes.append(
            "spectra are estimated from three channels: bands that no channel sees follow the library's"
        )
    return balls, material, tuple(dict.fromkeys(notes))


def _agreement(material: PhotoMaterial, readings: Readings | None, gloss: Mapping[float, float]) -> list[str]:
    """Return sentences on a material's distance from the values given beside its photographs."""
    notes, brdf = [], material.brdf
    if readings is not None:
        made, seen = brdf.eval(readings.wi, readings.wo), np.cbrt(np.maximum(readings.values, 0.0))
        if (nm := readings.wavelengths_nm) is not None:
            made = made @ interpolation_matrix(np.array(brdf.bands.wavelengths_nm), nm).T
        made = np.cbrt(made)
        is_read = np.isfinite(seen)
        error = float(np.linalg.norm((made - seen)[is_read]) / np.linalg.norm(seen[is_read]))
        alone = material.solution.contradiction
        notes.append(
            f"readings: cube roots differ by {100 * error:.1f} % (root mean square); predicted from the "
            f"photographs alone, by {100 * alone:.1f} %"
        )
        if alone > CONTRADICTION:
            notes.append(
                "readings and photographs contradict each other, and the photographs count less: check that both are "
                "of one material, and the light of the photographs"
            )
    given = {**(readings.gloss if readings is not None else {}), **gloss}
    for angle, units in gloss_units(brdf, given).items():
        notes.append(f"gloss at {angle:g} degrees: {given[angle]:g} given, {units:.3g} found")
    return notes


def _odd_pictures(names: Sequence[str], predicted: Sequence[float]) -> list[str]:
    """Return a sentence on each photograph that contradicts the others, by its error as these predict it.

    Of two, one says too little of sparkling materials in the light of the other.
    """
    if len(predicted) <= 2:
        return []
    usual = float(np.median(predicted))
    return [
        f"{name}: cube roots differ by {error:.0%} if the other pictures predict them, which contradict it: check that "
        "it shows the same material, its lamp and its outline"
        for name, error in zip(names, predicted, strict=False)
        if error > max(CONTRADICTION, _ODD * usual)
    ]


def draw_residuals(
    balls: Sequence[SeenBall], file: Path, material: PhotoMaterial, exposure: float | None, picture: Path
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


def srgb_responses(bands: Bands) -> Array:
    """Return responses (3, B) of linear sRGB to reflectances in B bands under D65; the identity for RGB bands."""
    return np.eye(3) if bands.is_rgb else xyz_to_srgb(xyz_weights(bands)).T


def read_responses(path: Path, bands: Bands) -> Array:
    """Read the responses (3, B) of a camera to reflectances under D65, 1 for a perfect diffuser.

    The file is text of wavelengths and three sensitivities, see `formats.spectra.read_spectrum`.
    """
    if bands.is_rgb:
        raise BandMismatchError(
            f"{path}: sensitivities of a camera need a spectral library, found {bands}; leave them out"
        )
    nm, sensitivities = read_spectrum(path, "sensitivity")
    nodes = np.arange(nm[0], nm[-1], 1.0)
    seen = interpolation_matrix(nm, nodes) @ np.maximum(sensitivities, 0.0)
    seen *= Illuminant.named("D65").at(nodes)[:, None]
    responses = interpolation_matrix(np.asarray(bands.wavelengths_nm), nodes).T @ seen
    if not np.all(responses.sum(axis=0) > 0.0):
        raise FileFormatError(f"{path}: a channel sees nothing of {bands}, expected sensitivities above 0")
    return np.asarray((responses / responses.sum(axis=0)).T)


def band_matrix(library: Library, names: tuple[str, ...], responses: Array) -> Array:
    """Return the matrix (B, 3) from channels of a camera to the bands of a library, by Wiener estimation.

    Deviations from a flat spectrum are linear in those of the channels, both relative to the mean of these: a neutral
    colour stays neutral. Learned from the library's named materials, off their highlights, and from measured
    reflectances; for responses see `srgb_responses`.

    Source: Haneishi et al. 2000, "System design for accurately estimating the spectral reflectance of art paintings".
    """
    if library.bands.is_rgb:
        return np.eye(3)
    spectra = np.vstack([_of_materials(library, names), _measured(library.bands)])
    return wiener_matrix(spectra, responses)


def wiener_matrix(spectra: Array, responses: Array) -> Array:
    """Return the Wiener matrix (B, 3) from spectra (n, B) and responses (3, B)."""
    seen = spectra @ responses.T
    level = np.maximum(seen.mean(axis=1, keepdims=True), 1e-4)
    x, y = seen / level - 1.0, spectra / level - 1.0
    covariance = x.T @ x / len(x) + _NOISE**2 * np.eye(3)
    deviations = np.linalg.solve(covariance, x.T @ y / len(x)).T  # [B, 3]
    return np.asarray(deviations @ (np.eye(3) - 1.0 / 3.0) + 1.0 / 3.0)


def _of_materials(library: Library, names: tuple[str, ...]) -> Array:
    wi, wo = (
        from_spherical(np.deg2rad([view[k] for view in _VIEWS_DEG]), azimuth)
        for k, azimuth in ((0, 0.0), (1, np.pi))
    )
    return np.pi * np.vstack(
        [np.maximum(MeasuredBRDF(library.read(name)).eval(wi, wo), 0.0) for name in names]
    )


def matrix_of_readings(
    readings: Readings, of_library: Bands, responses: Array, prior: Array
) -> tuple[Readings, Array]:
    """Return readings in the channels of a camera, and the matrix (B, 3) from channels to the bands of the result.

    The matrix reproduces the spectra of the readings from their channels as closely as its prior allows: with an RGB
    library the Wiener estimate of their bands, with a spectral one `prior` (B, 3). For bands see `bands_of`, for
    responses (3, B) to the library's bands `srgb_responses`.
    """
    read_nm = readings.wavelengths_nm
    if read_nm is None:
        return readings, prior
    nm = read_nm if of_library.is_rgb else np.array(of_library.wavelengths_nm)
    to_read, to_result = interpolation_matrix(nm, read_nm), interpolation_matrix(read_nm, nm)
    if of_library.is_rgb:
        responses = srgb_responses(readings.bands)
        prior = wiener_matrix(_measured(readings.bands), responses)
    channels = in_channels(readings, responses @ to_result)
    spectra = without_gaps(readings.values, read_nm)
    known = np.isfinite(spectra).all(axis=1)
    level = np.maximum(np.abs(spectra[known]).mean(axis=1, keepdims=True), np.finfo(float).tiny)
    x, y = channels.values[known] / level, spectra[known] / level
    precision = x.T @ x + (_NOISE / _UNLIKE) ** 2 * np.eye(3)
    change = np.linalg.solve(precision, x.T @ (y - x @ (to_read @ prior).T)).T
    return channels, to_result @ (to_read @ prior + change)


@cache
def _measured(bands: Bands) -> Array:
    at = np.asarray(bands.wavelengths_nm)
    nm = np.arange(400.0, 701.0, _STEP_NM)
    to_bands = interpolation_matrix(nm, at)
    return np.array([to_bands @ diffuse_reflectance(name, nm) for name in diffuse_reflectance_names()])
