"""The work behind `--photo` of `manifold complete` and `manifold locate`: photographs of a ball in, a material out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.colour.conversion import encode_srgb, to_srgb
from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.colour.pictures import read_picture
from manifold.errors import UsageError
from manifold.estimate import photo_figure
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.blocks import blocks_of
from manifold.estimate.circle import Circle, Cylinder, given_outline_notes, outlines_in
from manifold.estimate.gloss import gloss_units
from manifold.estimate.lamp_plan import LampPlan, plan_lamps
from manifold.estimate.lamps import LEAST_DISTANCE, Lamp, lamp_picture, parse_lamp
from manifold.estimate.light import Environment
from manifold.estimate.light_probe import find_light, given_lamp_notes
from manifold.estimate.mirror_ball import clipped_spots, unwrapped
from manifold.estimate.photo_files import Photograph, read_photograph
from manifold.estimate.photo_material import PhotoMaterial, Seen, Sighting, find_material
from manifold.estimate.pixels import Camera
from manifold.estimate.reading_bands import for_library, in_srgb
from manifold.estimate.spectra import band_matrix, read_responses, srgb_responses
from manifold.formats.readings import Readings
from manifold.io_rgl import read_bsdf
from manifold.library.store import Library
from manifold.model import diagnostics, located
from manifold.model.comparison import brdf_errors
from manifold.model.located import Located
from manifold.model.manifold import Manifold
from manifold.model.output_file import DEFAULT_OPTIONS, OutputOptions, require_bsdf_output, write_checked
from manifold.model.prediction import ClippedBRDF, PredictedBRDF
from manifold.plots import figures
from manifold.progress import Stages
from manifold.records import Array
from manifold.render import image_metrics
from manifold.render.render import render_floating_ball

_MARGIN = 0.05  # around the ball in pictures of residuals
_SIZE, _SAMPLES = 256, 32  # of predicted pictures
_BRIGHT = 0.9  # of the largest value of a light: most pixels above it are clipped where the camera did clip
_LEAST_COSINE = 0.05  # of a grey card's angle to its lamp


@dataclass(frozen=True)
class PhotoRequest:
    """Photographs of one material, and how they were taken. What there is one of holds for every photograph.

    Attributes:
        photographs: files.
        lights: environments, files or names of `environments.ENVIRONMENTS`; none where there are lamps.
        circles: of the balls, or of upright cylinders, as `Circle.parse` reads them; none where they are to be found.
        turns_deg: azimuths of what lies straight ahead in the environments.
        elevation_deg, distance: of the camera.
        exposure: of the photographs relative to the light; None where it is not known.
        responses: file of the camera's sensitivities; None for sRGB.
        lamps: of the photographs, as `lamps.parse_lamp` reads them; `found` finds them in the photographs.
        each: whether every photograph has an exposure of its own.
        grey: a card that faces the camera beside the ball, `X,Y,W,H,REFLECTANCE`, in pixels; None for none.
        is_linear: photographs are linear, whatever kind of files they are.
        dark: a photograph without light, that is subtracted from all; None for none.
        light_balls: photographs of a mirror ball in place of environments, by the same camera, `PICTURE` or
            `PICTURE@X,Y,R` with its outline.
    """

    photographs: Sequence[Path]
    lights: Sequence[str] = ()
    circles: Sequence[str] = ()
    turns_deg: Sequence[float] = (0.0,)
    elevation_deg: float = 0.0
    distance: float = np.inf
    exposure: float | None = 1.0
    responses: Path | None = None
    lamps: Sequence[str] = ()
    each: bool = False
    grey: str | None = None
    is_linear: bool = False
    dark: Path | None = None
    light_balls: Sequence[str] = ()

    @property
    def has_cylinder(self) -> bool:
        """Whether an outline is that of a cylinder. Raises: UsageError, of what is no outline."""
        return any(isinstance(Circle.parse(text), Cylinder) for text in self.circles)


@dataclass(frozen=True, eq=False)
class SeenBall:
    """A photograph, the ball in it, and its light as a picture.

    Attributes:
        photograph: as read.
        circle: of the ball.
        light: linear radiance, shape (H, W, 3); None of lamps.
        sighting: of the ball.
        notes: assumptions about the files of both, in sentences.
    """

    photograph: Photograph
    circle: Circle
    light: Array | None
    sighting: Sighting
    notes: tuple[str, ...] = ()

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        """Of the light; none of an environment."""
        return () if isinstance(self.sighting.light, Environment) else tuple(self.sighting.light)


@dataclass(frozen=True, eq=False)
class FromPhotographs:
    """A material that was found in photographs.

    Attributes:
        balls: what was seen.
        material: what was found.
        located: its place on a map, where it was asked for.
        output: the file that was written, if any.
        plausibility: of that file.
        picture: of photographs, predictions and differences, if it was asked for.
        diagnostics: what a user should know before trusting it, in sentences.
        seconds: in all.
        plan: where to hold the lamp next, where that was asked for.
    """

    balls: tuple[SeenBall, ...]
    material: PhotoMaterial
    located: Located | None
    output: Path | None
    plausibility: Plausibility | None
    picture: Path | None
    diagnostics: tuple[str, ...]
    seconds: float
    plan: LampPlan | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            **self.material.to_json(),
            "photographs": [
                {
                    "path": str(ball.photograph.path),
                    "circle": list(vars(ball.circle).values()),
                    "lamps": [lamp.direction.tolist() for lamp in ball.lamps],
                }
                for ball in self.balls
            ],
            "located": None if self.located is None else self.located.to_json(),
            "output": None if self.output is None else str(self.output),
            "picture": None if self.picture is None else str(self.picture),
            "plausibility": self.plausibility and vars(self.plausibility),
            "diagnostics": list(self.diagnostics),
            "seconds": self.seconds,
            "plan": self.plan and self.plan.to_json(),
        }


def complete_photographs(
    request: PhotoRequest,
    library: Path,
    output: Path,
    *,
    readings: Readings | None = None,
    gloss: Mapping[float, float] = MappingProxyType({}),
    picture: Path | None = None,
    count: int = 0,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> FromPhotographs:
    """Find the material of photographed balls, and readings of it, with a library as prior, and write it.

    Args:
        request: the photographs.
        library: of measured materials.
        output: the `.bsdf` file to write.
        readings: of the same material, if there are any.
        gloss: units of a gloss meter by its angle in degrees, if there are any.
        picture: of photographs, predictions and differences; None draws none.
        count: how many further pictures to suggest.
        options: of the output.
    Raises:
        MissingFileError, FileFormatError: a picture cannot be read.
        BandMismatchError: readings or sensitivities do not go with the bands of the library.
        UsageError: no ball is found, most of it is clipped, the output cannot be written, or `strict` is set and
            its albedo would exceed 1.05.
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
    notes += (*diagnostics.of_prediction(False, written.plausibility), *written.projection)
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
        balls, material, None, output, written.plausibility, picture, notes, time.perf_counter() - start, plan
    )


def locate_photographs(
    model: Manifold | Path | str,
    request: PhotoRequest,
    output: Path | None = None,
    *,
    library: Path | None = None,
    picture: Path | None = None,
    options: OutputOptions = DEFAULT_OPTIONS,
) -> FromPhotographs:
    """Find the place of photographed balls on a fitted manifold; what is written is the prediction there.

    Args and raises: as `complete_photographs`, and
        model: a fitted manifold, or the path of one.
        library: where its library is now, if not where the model remembers it.
    """
    start = time.perf_counter()
    if output is not None:
        require_bsdf_output(output)
    stages = _stages(picture, request)
    loaded = model if isinstance(model, Manifold) else Manifold.load(model, library)
    balls, material, notes = _found(request, loaded.library, None, {}, stages)
    seen = ClippedBRDF(material.brdf)
    place = located.locate_brdf(loaded, seen)
    notes += (
        *place.diagnostics,
        "the expected error and the residual of pixels are those of the material that the pixels show, the "
        "reconstruction error is that of the prediction at the place against it",
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
            notes += (*diagnostics.of_prediction(False, plausibility), *written.projection)
        if picture is not None:
            stages.begin("rendering")
            draw_residuals(balls, shown, material, request.exposure, picture)
    return FromPhotographs(
        balls, material, place, output, plausibility, picture, notes, time.perf_counter() - start
    )


def _stages(picture: Path | None, request: PhotoRequest) -> Stages:
    """Stages of the work, whose picture can be drawn. Raises: UsageError."""
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
    """What was seen, the material, and notes."""
    stages.begin("reading pictures")
    balls = see(request)
    responses = (
        srgb_responses(library.bands)
        if request.responses is None
        else read_responses(request.responses, library.bands)
    )
    if readings is not None:
        if not library.bands.is_rgb:
            raise UsageError(
                f"photographs and readings together, and a library of {library.bands}, expected one in RGB; give the "
                "readings or the photographs alone, or convert the library"
            )
        readings = in_srgb(for_library(readings, library.bands))
    stages.begin("reading materials")
    atoms = LibraryAtoms.of_library(library).in_values
    stages.begin("comparing pixels")
    seen: list[Seen] = [ball.sighting for ball in balls]
    if readings is not None:
        seen.append(readings)
    if gloss:
        seen.append(gloss)
    material = find_material(
        atoms, seen, library.bands, band_matrix(library, atoms.names, responses),
        exposure=request.exposure, each=request.each, library=library,
    )  # fmt: skip
    notes = [note for ball in balls for note in ball.notes] + list(material.notes)
    if request.exposure is None:
        notes.append(
            "the exposure was estimated from how bright the library's materials are: lightness may be off by a factor "
            "of two and more, which the expected errors include; a grey card in the picture (--grey) fixes it"
        )
    if readings is not None:
        notes += readings.notes
    notes += _agreement(material.brdf, readings, gloss)
    if not library.bands.is_rgb:
        notes.append(
            "spectra are estimated from three channels: bands that no channel sees follow the library's"
        )
    return balls, material, tuple(dict.fromkeys(notes))


def _agreement(brdf: PredictedBRDF, readings: Readings | None, gloss: Mapping[float, float]) -> list[str]:
    """How far a material is from what was given beside its photographs, in sentences."""
    notes = []
    if readings is not None:
        made, seen = np.cbrt(brdf.eval(readings.wi, readings.wo)), np.cbrt(np.maximum(readings.values, 0.0))
        is_read = np.isfinite(seen)
        error = float(np.linalg.norm((made - seen)[is_read]) / np.linalg.norm(seen[is_read]))
        notes.append(f"readings: cube roots differ by {100 * error:.1f} % (root mean square)")
    given = {**(readings.gloss if readings is not None else {}), **gloss}
    for angle, units in gloss_units(brdf, given).items():
        notes.append(f"gloss at {angle:g} degrees: {given[angle]:g} given, {units:.3g} found")
    return notes


def see(request: PhotoRequest) -> tuple[SeenBall, ...]:
    """Read photographs and lights, and find the balls.

    Raises:
        MissingFileError, FileFormatError: a picture cannot be read.
        UsageError: no ball is found, or there are not as many lights, circles or turns as photographs, or one.
    """
    if not request.distance > 1.0:
        raise UsageError(f"a camera at {request.distance:g} radii of the ball, expected more than 1")
    if request.exposure is not None and not 0.0 < request.exposure < np.inf:
        raise UsageError(f"exposure {request.exposure:g}, expected a number above 0")
    angles_deg = (*request.turns_deg, request.elevation_deg)
    if not np.isfinite(angles_deg).all():
        raise UsageError(
            f"turns and elevation of {', '.join(f'{a:g}' for a in angles_deg)}, expected finite angles"
        )
    n = len(request.photographs)
    circles, turns = (
        _for_each(n, values, what)
        for values, what in ((request.circles or [""], "circles"), (request.turns_deg, "turns"))
    )
    is_plain = not request.elevation_deg and np.isinf(request.distance) and _found_at(request) is None
    if request.has_cylinder and not is_plain:
        raise UsageError(
            "a cylinder with --elevation, --distance or --lamp found, expected a far, level camera and a known light"
        )
    photographs = [read_photograph(path, request.is_linear) for path in request.photographs]
    if request.dark is not None:
        photographs = _without_dark(photographs, read_photograph(request.dark, request.is_linear))
    if request.lamps:
        return _with_doubts(_under_lamps(request, photographs, circles), circles)
    if request.grey is not None:
        raise UsageError("--grey goes with --lamp; of a --light, give the --exposure")
    if request.light_balls:
        if any(request.turns_deg):
            raise UsageError("--turn goes with --light; a mirror ball is seen by the same camera")
        lights = _for_each(n, request.light_balls, "mirror balls")
        camera = Camera(0.0, request.elevation_deg, request.distance)
        read = {text: _around(text, camera, request.is_linear) for text in dict.fromkeys(lights)}
    else:
        lights = _for_each(n, request.lights, "lights")
        read = {name: (*_light(name), ()) for name in dict.fromkeys(lights)}
    balls = []
    for photograph, light, text, turn_deg in zip(photographs, lights, circles, turns, strict=True):
        circle, doubts = _outline_of([photograph], text)
        image, made, notes, spots = read[light]
        camera = Camera(turn_deg, request.elevation_deg, request.distance)
        sighting = Sighting(blocks_of(photograph, circle, n), camera, made, spots)
        balls.append(SeenBall(photograph, circle, image, sighting, photograph.notes + notes + doubts))
    return _with_doubts(balls, circles)


def _under_lamps(
    request: PhotoRequest, photographs: Sequence[Photograph], circles: Sequence[str]
) -> list[SeenBall]:
    """Balls under lamps that are given, or found."""
    camera, notes = Camera(distance=request.distance), tuple[str, ...]()
    if request.elevation_deg or any(request.turns_deg):
        raise UsageError("--turn and --elevation go with --light; lamps are in the camera's frame")
    is_common = len(set(circles)) == 1 and len({one.values.shape for one in photographs}) == 1
    if (apart := _found_at(request)) is not None:
        if len(set(circles)) > 1:
            raise UsageError("different circles, expected one for all photographs to find their lamps")
        probe = find_light(photographs, Circle.parse(circles[0]) if circles[0] else None, apart)
        lamps, notes = list(probe.lamps), probe.notes
        outlines = [(probe.circle, tuple[str, ...]())] * len(photographs)
    else:
        given = [lamp for text in request.lamps for lamp in parse_lamp(text)]
        lamps = _for_each(len(photographs), given, "lamps")
        if is_common:
            outlines = [_outline_of(photographs, circles[0])] * len(photographs)
        else:
            outlines = [_outline_of([one], text) for one, text in zip(photographs, circles, strict=True)]
    if request.grey is None:
        notes += (
            "the lamp is taken as white: whatever colour it has, the material's is off by it; balance the picture's "
            "white, or give a grey card (--grey)",
        )
    balls = []
    for photograph, lamp, (circle, doubts) in zip(photographs, lamps, outlines, strict=True):
        seen = photograph if request.grey is None else _balanced(photograph, request.grey, lamp)
        sighting = Sighting(blocks_of(seen, circle, len(photographs)), camera, (lamp,))
        own = photograph.notes + notes + doubts
        if apart is None and not isinstance(circle, Cylinder):
            own += given_lamp_notes(photograph, circle, lamp)
        balls.append(SeenBall(seen, circle, None, sighting, own))
    return balls


def _found_at(request: PhotoRequest) -> float | None:
    """The distance of lamps that are to be found, in radii of the ball, far where none is given; None of given lamps.

    Raises:
        UsageError: it is no distance, or several are given.
    """
    if not any(text.partition(",")[0] == "found" for text in request.lamps):
        return None
    _, _, distance = request.lamps[0].partition(",")
    try:
        apart = float(distance) if distance else np.inf
    except ValueError:
        apart = np.nan
    if len(request.lamps) > 1 or not apart >= LEAST_DISTANCE:
        raise UsageError(
            f"lamp '{request.lamps[-1]}', expected found once, or found,D with the lamps' distance in radii of the ball"
        )
    return apart


def _balanced(photograph: Photograph, grey: str, lamp: Lamp) -> Photograph:
    """A photograph relative to a white diffuser that faces its lamp, by a grey card that faces the camera.

    Raises:
        UsageError: the card is not in the picture, is clipped or black, or its lamp does not light it.
    """
    try:
        x, y, width, height, reflectance = (float(part) for part in grey.split(","))
    except ValueError:
        x = y = width = height = reflectance = np.nan
    rows, columns = photograph.values.shape[:2]
    inside = x >= 0 and y >= 0 and width >= 2 and height >= 2 and x + width <= columns and y + height <= rows
    if not (inside and 0.0 < reflectance <= 1.0):
        raise UsageError(
            f"card '{grey}', expected X,Y,W,H,REFLECTANCE: its corner and size in pixels within {columns} x {rows}, "
            "and its reflectance up to 1, such as 20,30,80,80,0.18"
        )
    part = slice(int(y), int(y + height)), slice(int(x), int(x + width))
    mean = photograph.values[part].mean(axis=(0, 1))
    cosine = float(lamp.direction[2])
    if photograph.is_clipped[part].any() or not np.all(mean > 0.0) or cosine < _LEAST_COSINE:
        raise UsageError(
            f"{photograph.path}: the card at {grey} is clipped, black, or lit from behind, expected one that the lamp "
            "lights and the camera does not clip"
        )
    return replace(photograph, values=photograph.values * (reflectance * cosine / mean).astype(np.float32))


def _without_dark(photographs: Sequence[Photograph], dark: Photograph) -> list[Photograph]:
    """Photographs less one that was taken without light.

    Raises:
        UsageError: it is of another size.
    """
    if any(one.values.shape != dark.values.shape for one in photographs):
        raise UsageError(f"{dark.path}: of another size than the photographs, expected the same camera")
    return [replace(one, values=np.maximum(one.values - dark.values, 0.0)) for one in photographs]


def _outline_of(photographs: Sequence[Photograph], given: str) -> tuple[Circle, tuple[str, ...]]:
    """The outline of the ball in photographs of one size, given or the likeliest, and doubts about the latter.

    Raises: as `outlines_in` and `Circle.parse`.
    """
    if given:
        return Circle.parse(given), ()
    best = outlines_in(photographs)[0]
    return best.circle, best.notes


def _with_doubts(balls: Sequence[SeenBall], given: Sequence[str]) -> tuple[SeenBall, ...]:
    """Balls with doubts about the outlines that were given."""
    return tuple(
        replace(ball, notes=ball.notes + given_outline_notes([ball.photograph], ball.circle))
        if text and not isinstance(ball.circle, Cylinder)
        else ball
        for ball, text in zip(balls, given, strict=True)
    )


def _for_each(n: int, values: Sequence[Any], what: str) -> list[Any]:
    if len(values) not in (1, n):
        raise UsageError(f"{len(values)} {what} for {n} photographs, expected one, or one for each")
    return list(values) * (n if len(values) == 1 else 1)


def _light(name: str) -> tuple[Array, Environment, tuple[str, ...]]:
    """An environment by its file or name, as a picture and for sampling, and notes."""
    notes: tuple[str, ...] = ()
    if name in ENVIRONMENTS and not Path(name).is_file():
        image = environment(name, 256).astype(float)
    else:
        picture = read_picture(Path(name))
        image = np.where(picture.is_opaque[..., None], picture.values, np.nan).astype(float)
        notes = picture.notes
        count = np.count_nonzero(picture.is_clipped)
        bright = np.count_nonzero(image.max(axis=2) > _BRIGHT * image.max())
        if count > (
            0 if picture.is_encoded else 0.5 * bright
        ):  # lights made by programs have some equal values
            notes += (
                f"{Path(name).name}: its {count} brightest pixels have one value; if the camera clipped them, the "
                "light is brighter than this, and the material comes out too bright",
            )
    try:
        return image, Environment.of(image), notes
    except UsageError as error:
        raise UsageError(f"{name}: {error}") from error


def _around(
    text: str, camera: Camera, is_linear: bool
) -> tuple[Array, Environment, tuple[str, ...], Sequence[Lamp]]:
    """The environment that a photographed mirror ball shows: as a picture, for sampling, notes, and clipped spots."""
    name, _, given = (text, "", "") if Path(text).is_file() else text.rpartition("@")
    path = Path(name or text)
    photograph = read_photograph(path, is_linear)
    circle, doubts = _outline_of([photograph], given if name else "")
    image = unwrapped(photograph, circle, camera)
    notes = (*photograph.notes, *doubts, f"{path.name}: taken as a perfect mirror, its outline at {circle}")
    try:
        return image, Environment.of(image), notes, clipped_spots(photograph, circle)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error


def draw_residuals(
    balls: Sequence[SeenBall], file: Path, material: PhotoMaterial, exposure: float | None, picture: Path
) -> None:
    """Draw photographs beside renders of a file, with their differences.

    A known exposure is divided out; with one that was estimated, photographs stay as they are, and renders are exposed
    alike: else a wrong one would make all white, or black, and differences small.
    """
    known = exposure or 1.0
    seen, predicted, errors = [], [], []
    for ball in balls:
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
        made = made * (material.exposure / known)
        shown = [encode_srgb(np.nan_to_num(each)) for each in (crop, made)]
        across = (1.0 + _MARGIN) * (2.0 * (np.arange(_SIZE) + 0.5) / _SIZE - 1.0)
        compared = np.hypot(across, across[:, None]) < 0.97
        compared &= np.isfinite(crop).all(axis=2) & ~clipped
        seen.append(crop)
        predicted.append(made)
        errors.append(np.where(compared, image_metrics.ciede2000_map(*shown), np.nan))
    names = [ball.photograph.path.name for ball in balls]
    figures.save(photo_figure.residual_figure(names, seen, predicted, errors), picture)


def _cropped(values: Array, circle: Circle) -> Array:
    """The square around a circle, nearest pixels, NaN beyond the picture: shape (_SIZE, _SIZE, C)."""
    across = (1.0 + _MARGIN) * circle.radius * (2.0 * (np.arange(_SIZE) + 0.5) / _SIZE - 1.0)
    rows, columns = (np.floor(centre + across).astype(int) for centre in (circle.y, circle.x))
    inside = [(at >= 0) & (at < n) for at, n in zip((rows, columns), values.shape, strict=False)]
    picked = values[np.clip(rows, 0, values.shape[0] - 1)[:, None], np.clip(columns, 0, values.shape[1] - 1)]
    return np.where((inside[0][:, None] & inside[1])[..., None], picked, np.nan)
