"""Combines photographs of balls with their light and camera, and computes the pixels of atoms in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from manifold.colour.lights import ENVIRONMENTS, environment
from manifold.colour.picture_files import read_picture
from manifold.core.errors import UsageError
from manifold.core.names import counted, percent
from manifold.core.records import Array, Mask
from manifold.estimate.atoms import LibraryAtoms
from manifold.estimate.lamps import (
    LEAST_DISTANCE,
    MOST_DISTANCE,
    Lamp,
    clipped_spots,
    intensity_notes,
    lamp_pairs,
    parse_lamp,
    require_in_front,
    unwrapped,
)
from manifold.estimate.light_probe import (
    doubt_encoding,
    find_light,
    given_encoding_notes,
    given_lamp_notes,
)
from manifold.estimate.outlines import (
    Circle,
    Cylinder,
    Photograph,
    given_outline_notes,
    outlines_in,
    outside,
    read_photograph,
)
from manifold.estimate.pixels import (
    SAMPLES,
    Blocks,
    Camera,
    Environment,
    block_sums,
    blocks_of,
    direction_pairs,
)
from manifold.model.estimator import Observation

_BRIGHT = 0.9  # share of a light's largest value; most pixels above it are clipped where the camera clipped
_MOST_BRIGHT = 1.2  # a perfect diffuser has 1 where it faces the lamp: a quarter of its ball has at most 0.9
_LEAST_COSINE = 0.05  # least cosine of a grey card's angle to its lamp
_HIGHLIGHT_DEG = 15.0  # largest angle of a highlight's half vector from the normal
_DIFFERENCES_DEG = np.arange(0.0, 91.0, 15.0)  # edges of bins of angles between directions and half vector
_LEAST_LIGHT = 1e-3  # mean light: 0.1 under a lamp at the camera, 1e-4 on a cylinder straight below a lamp
_MOST_OUTSIDE = 0.02  # share of a mirror ball outside its picture, where an outline touches the edge
_UNLIT = 0.02  # share of a pixel's light below which nothing is learned


@dataclass(frozen=True)
class PhotoRequest:
    """Photographs of one material, and how they were taken; a single value applies to every photograph.

    Attributes:
        lights: files or names (`colour.lights.ENVIRONMENTS`) of environments; empty if there are lamps.
        circles: outlines of the balls or upright cylinders, in the form of `Circle.parse`; empty to find them.
        turns_deg: azimuths in the environments that lie straight ahead of the camera.
        elevation_deg, distance: elevation of the camera above the ball, and its distance in radii.
        exposure: exposure of the photographs relative to the light; None if it is unknown.
        responses: file of the camera's sensitivities; None for sRGB.
        lamps: lamps of the photographs, in the form of `lamps.parse_lamp`; `found` estimates them from the
            photographs.
        each: whether every photograph has its own exposure; None means yes, unless files of lamps state intensities.
        grey: grey card that faces the camera beside the ball, `X,Y,W,H,REFLECTANCE`, in pixels; None without one.
        is_linear: whether the values of all files are linear, or encoded for a display, see
            `colour.picture_files.read_picture`; None follows each file.
        dark: photograph without light, which is subtracted from all others; None without one.
        light_balls: photographs of a mirror ball by the same camera, in place of environments, `PICTURE` or
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
    each: bool | None = False
    grey: str | None = None
    is_linear: bool | None = None
    dark: Path | None = None
    light_balls: Sequence[str] = ()

    @property
    def has_cylinder(self) -> bool:
        """Return whether one of the outlines is a cylinder."""
        return any(isinstance(Circle.parse(text), Cylinder) for text in self.circles)


@dataclass(frozen=True, eq=False)
class Sighting:
    """A ball in a photograph, with its light and camera.

    Attributes:
        light: an environment in the camera's channels, or lamps.
        spots: lamps of unknown strength that replace clipped parts of the environment.
    """

    blocks: Blocks
    camera: Camera
    light: Environment | Sequence[Lamp]
    spots: Sequence[Lamp] = ()

    @cached_property
    def pairs(self) -> tuple[Array, Array, Array]:
        """Return the direction pairs of the blocks, and their light; see `pixels.direction_pairs`."""
        if not isinstance(self.light, Environment):
            return lamp_pairs(self.blocks, self.camera, self.light)
        return direction_pairs(self.blocks, self.camera, self.light, SAMPLES)

    def sums(self, atoms: LibraryAtoms) -> tuple[Array, Array | float]:
        """Return the pixels of atoms under the light, and under the spots, each (n, C, K); 0 without spots."""
        of_spots = lamp_pairs(self.blocks, self.camera, self.spots) if self.spots else None
        return block_sums(atoms.at, *self.pairs), block_sums(atoms.at, *of_spots) if of_spots else 0.0

    def rows(self, sums: Array) -> list[Observation]:
        """Return the observation of every channel, given the pixels `sums` (n, C, K) of the atoms.

        Small blocks weigh more than in proportion to their number of pixels, because highlights are small.
        """
        counts, blocks = np.sqrt(self.blocks.counts), self.blocks
        channels = range(sums.shape[1])
        return [
            Observation(sums[:, c], blocks.values[:, c], counts, blocks.is_clipped[:, c]) for c in channels
        ]


@dataclass(frozen=True, eq=False)
class SeenBall:
    """A photograph, the ball in it, and a picture of its light.

    Attributes:
        light: linear radiance of the environment, shape (H, W, 3); None for lamps.
        notes: assumptions about the files of photograph and light, in sentences.
        warnings: sentences that say why the estimate is likely wrong; they are shown first.
        lamp_deg: standard deviation of an estimated lamp's direction, in degrees; None if the lamp was given.
    """

    photograph: Photograph
    circle: Circle
    light: Array | None
    sighting: Sighting
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    lamp_deg: float | None = None

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        """Return the lamps; empty for an environment."""
        return () if isinstance(self.sighting.light, Environment) else tuple(self.sighting.light)


def see(request: PhotoRequest) -> tuple[SeenBall, ...]:
    """Read photographs and their lights, and find the balls."""
    if not (1.0 < request.distance <= MOST_DISTANCE or np.isinf(request.distance)):
        raise UsageError(
            f"a camera at {request.distance:g} radii of the ball, expected more than 1 and at most {MOST_DISTANCE:g}"
        )
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
        raise UsageError("--grey works only with --lamp; for a --light, give the --exposure")
    if request.light_balls:
        if any(request.turns_deg):
            raise UsageError("--turn works only with --light; a mirror ball is seen by the same camera")
        lights = _for_each(n, request.light_balls, "mirror balls")
        camera = Camera(0.0, request.elevation_deg, request.distance)
        read = {text: _around(text, camera, request.is_linear) for text in dict.fromkeys(lights)}
    else:
        lights = _for_each(n, request.lights, "lights")
        read = {name: (*_light(name, request.is_linear), ()) for name in dict.fromkeys(lights)}
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
    """Return balls under lamps that are given or estimated."""
    camera, notes, warnings = Camera(distance=request.distance), tuple[str, ...](), tuple[str, ...]()
    uncertain: Sequence[float | None] = [None] * len(photographs)
    if request.elevation_deg or any(request.turns_deg):
        raise UsageError("--turn and --elevation work only with --light; lamps are in the camera's frame")
    is_common = len(set(circles)) == 1 and len({one.values.shape for one in photographs}) == 1
    if (apart := _found_at(request)) is not None:
        if len(set(circles)) > 1:
            raise UsageError(
                "different circles, expected the same circle for all photographs to estimate their lamps"
            )
        given_circle = _outline_of(photographs, circles[0])[0] if circles[0] else None
        probe = find_light(photographs, given_circle, apart)
        probe, warnings = doubt_encoding(photographs, probe)
        lamps, notes, uncertain = list(probe.lamps), probe.notes, probe.lamp_deg
        outlines = [(probe.circle, tuple[str, ...]())] * len(photographs)
    else:
        names = [path.name for path in request.photographs]
        given = [lamp for text in request.lamps for lamp in parse_lamp(text, names)]
        lamps = _for_each(len(photographs), given, "lamps")
        require_in_front(lamps, names, 0.0, "the ball")
        notes += tuple(note for text in request.lamps for note in intensity_notes(Path(text)))
        if is_common:
            outlines = [_outline_of(photographs, circles[0])] * len(photographs)
        else:
            outlines = [_outline_of([one], text) for one, text in zip(photographs, circles, strict=True)]
        if not request.has_cylinder:
            found = [circle for circle, _ in outlines]
            warnings = given_encoding_notes(photographs, found, lamps, are_given=all(circles))
    if request.grey is not None:  # which measures the light
        lamps = [replace(lamp, colour=np.ones(3)) for lamp in lamps]
    elif not all(lamp.known == "colour" for lamp in lamps):
        notes += (
            "the lamp is assumed to be white; a coloured lamp changes the material's colour; correct the picture's "
            "white balance, or give a grey card (--grey)",
        )
    balls = []
    for photograph, lamp, off, (circle, doubts) in zip(photographs, lamps, uncertain, outlines, strict=True):
        seen = photograph
        if request.grey is not None:
            seen = _balanced(photograph, request.grey, lamp)
            _require_possible(seen, circle, request.grey)
        sighting = Sighting(blocks_of(seen, circle, len(photographs)), camera, (lamp,))
        own = photograph.notes + notes + doubts
        if apart is None and not warnings and not isinstance(circle, Cylinder):
            own += given_lamp_notes(photograph, circle, lamp)
        if np.mean(sighting.pairs[2] / lamp.colour) < _LEAST_LIGHT:
            raise UsageError(
                f"{photograph.path}: a lamp at {lamp} lights no part of the ball that the camera sees, expected one in "
                "front of it: x to the right, y up, z to the camera"
            )
        balls.append(SeenBall(seen, circle, None, sighting, own, warnings, off))
    return balls


def have_own_exposures(request: PhotoRequest, balls: Sequence[SeenBall]) -> bool:
    """Return whether every photograph has its own exposure, or its lamp its own strength."""
    if request.each is None:
        return not all(lamp.known for ball in balls for lamp in ball.lamps)
    return request.each


def _found_at(request: PhotoRequest) -> float | None:
    """Return the distance of lamps to estimate, in ball radii, by default far; None for given lamps."""
    if not any(text.partition(",")[0] == "found" for text in request.lamps):
        return None
    _, _, distance = request.lamps[0].partition(",")
    try:
        apart = float(distance) if distance else np.inf
    except ValueError:
        apart = np.nan
    if len(request.lamps) > 1 or not (LEAST_DISTANCE <= apart <= MOST_DISTANCE or np.isinf(apart)):
        raise UsageError(
            f"lamp '{request.lamps[-1]}', expected found once, or found,D with the lamps' distance in radii of the ball"
        )
    return apart


def _balanced(photograph: Photograph, grey: str, lamp: Lamp) -> Photograph:
    """Return a photograph relative to a white diffuser that faces its lamp, by a grey card that faces the camera."""
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


def _require_possible(balanced: Photograph, circle: Circle, grey: str) -> None:
    """Raise UsageError where a grey card makes a ball brighter than any material under the lamp."""
    if isinstance(circle, Cylinder):
        return
    rows, columns = (np.arange(n) + 0.5 for n in balanced.values.shape[:2])
    right, up = np.meshgrid((columns - circle.x) / circle.radius, (circle.y - rows) / circle.radius)
    bright = balanced.values[circle.contains(right, up, 0.9)].mean(axis=1)
    bright = bright[np.isfinite(bright)]
    level = float(np.quantile(bright, 0.75)) if len(bright) else 0.0
    if level > _MOST_BRIGHT:
        raise UsageError(
            f"{balanced.path}: according to the grey card at {grey}, a quarter of the ball is more than {level:.1f} "
            "times as bright as a white surface that faces the lamp, which is impossible; expected a card that the "
            "same lamp lights, not the background or a shadow, and its reflectance"
        )


def _without_dark(photographs: Sequence[Photograph], dark: Photograph) -> list[Photograph]:
    """Subtract a photograph that was taken without light."""
    if any(one.values.shape != dark.values.shape for one in photographs):
        raise UsageError(f"{dark.path}: of another size than the photographs, expected the same camera")
    return [replace(one, values=np.maximum(one.values - dark.values, 0.0)) for one in photographs]


def _outline_of(photographs: Sequence[Photograph], given: str) -> tuple[Circle, tuple[str, ...]]:
    """Return the given or likeliest outline of the ball in photographs of one size, and doubts about the latter."""
    if given:
        circle = Circle.parse(given)
        if not isinstance(circle, Cylinder):
            circle.require_inside(photographs[0])
        return circle, ()
    best = outlines_in(photographs)[0]
    return best.circle, best.notes


def _with_doubts(balls: Sequence[SeenBall], given: Sequence[str]) -> tuple[SeenBall, ...]:
    """Return balls with doubts about the outlines that were given."""
    return tuple(
        replace(ball, notes=ball.notes + given_outline_notes([ball.photograph], ball.circle))
        if text and not isinstance(ball.circle, Cylinder)
        else ball
        for ball, text in zip(balls, given, strict=True)
    )


def _for_each(n: int, values: Sequence[Any], what: str) -> list[Any]:
    if len(values) not in (1, n):
        raise UsageError(
            f"{len(values)} {what} for {counted(n, 'photograph')}, expected one, or one for each"
        )
    return list(values) * (n if len(values) == 1 else 1)


def _light(name: str, is_linear: bool | None) -> tuple[Array, Environment, tuple[str, ...]]:
    """Return an environment by its file or name, as a picture and for sampling, and notes."""
    notes: tuple[str, ...] = ()
    if name in ENVIRONMENTS and not Path(name).is_file():
        image = environment(name, 256).astype(float)
    else:
        picture = read_picture(Path(name), is_linear)
        image = np.where(picture.is_opaque[..., None], picture.values, np.nan).astype(float)
        notes = picture.notes
        count = np.count_nonzero(picture.is_clipped.any(axis=2))
        bright = np.count_nonzero(image.max(axis=2) > _BRIGHT * image.max())
        # Lights made by programs have some equal values.
        if count > (0 if picture.is_encoded else 0.5 * bright):
            notes += (
                f"{Path(name).name}: its {count} brightest pixels have the same value; if the camera clipped them, the "
                "light is brighter than this, and the estimated material is too bright",
            )
    try:
        return image, Environment.of(image), notes
    except UsageError as error:
        raise UsageError(f"{name}: {error}") from error


def _around(
    text: str, camera: Camera, is_linear: bool | None
) -> tuple[Array, Environment, tuple[str, ...], Sequence[Lamp]]:
    """Return a photographed mirror ball's environment: as a picture, for sampling, notes, and clipped spots."""
    name, _, given = (text, "", "") if Path(text).is_file() else text.rpartition("@")
    path = Path(name or text)
    photograph = read_photograph(path, is_linear)
    circle, doubts = _outline_of([photograph], given if name else "")
    if (beside := outside(photograph, circle)) > _MOST_OUTSIDE:
        raise UsageError(
            f"{path}: {percent(beside)} of the mirror ball at {circle} lies outside the picture, expected the whole "
            "ball"
        )
    image = unwrapped(photograph, circle, camera)
    notes = (
        *photograph.notes,
        *doubts,
        f"{path.name}: treated as a perfect mirror with the outline {circle}",
    )
    try:
        return image, Environment.of(image), notes, clipped_spots(photograph, circle)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error


def unlit(sightings: Sequence[Sighting]) -> tuple[str, ...]:
    """Return a sentence in a tuple if no lamp shows the highlights; otherwise an empty tuple."""
    most = np.zeros(len(_DIFFERENCES_DEG) - 1)
    for sighting in sightings:
        wi, wo, light = sighting.pairs
        h = wi + wo
        h /= np.linalg.norm(h, axis=-1, keepdims=True)
        near = np.rad2deg(np.arccos(np.clip(h[..., 2], -1.0, 1.0))) < _HIGHLIGHT_DEG
        apart = np.rad2deg(np.arccos(np.clip(np.sum(wi * h, axis=-1), -1.0, 1.0)))
        total = light.sum(axis=(1, 2))
        for k, (low, high) in enumerate(pairwise(_DIFFERENCES_DEG)):
            part = np.where(near & (apart >= low) & (apart < high), light.sum(axis=-1), 0.0).sum(axis=1)
            most[k] = max(most[k], float((part / np.maximum(total, np.finfo(float).tiny)).max()))
    dark: Mask = most < _UNLIT
    if not dark.any():
        return ()
    ranges: list[list[float]] = []
    for (low, high), is_dark in zip(pairwise(_DIFFERENCES_DEG), dark, strict=True):
        if is_dark and ranges and ranges[-1][1] == low:
            ranges[-1][1] = high
        elif is_dark:
            ranges.append([low, high])
    words = " and ".join(f"{low:.0f} to {high:.0f}" for low, high in ranges)
    return (
        f"no lamp shows highlights at incidences of {words} degrees: highlights there follow the "
        "library's materials",
    )
