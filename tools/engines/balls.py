"""The lights in which engines draw balls, Mitsuba's balls of measured files, and their differences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from manifold.brdf.interface import EvaluableBRDF
from manifold.colour import ball_colours, panel
from manifold.colour.conversion import encode_srgb, srgb_to_xyz, xyz_to_srgb
from manifold.colour.difference import delta_e_2000
from manifold.core.directions import from_spherical, normalize
from manifold.core.records import Array
from manifold.render import backend, images, scenes
from manifold.render.render import RenderSettings, render_scene, rgb_film

SIZE = 64  # pixels of a side
EDGE = 1.0  # radii of the ball that half the picture's side shows
ROWS = 256  # of environments; there are twice as many columns
_RIM = 0.95  # radii within which pixels are compared: farther out, engines smooth the outline
_RINGS, _SPOKES = 24, 16  # of balls by quadrature
_SAMPLES = 1024  # light paths a pixel

Pictures = Mapping[str, Array]
"""Linear radiance (SIZE, SIZE, 3) by the name of the light, rows from above."""


def y_up(world: Array) -> Array:
    """Directions (..., 3) of a world with z up in one with y up."""
    return np.asarray(world)[..., [0, 2, 1]] * [1.0, 1.0, -1.0]


def layout(engine: str, rows: int) -> Array:
    """Directions, z up, of the pixels of an engine's environment, shape (rows, 2 rows, 3)."""
    theta = (np.arange(rows) + 0.5)[:, None] / rows * np.pi
    phi = -(np.arange(2 * rows) + 0.5)[None] / rows * np.pi  # all turn to the right
    if engine == "three.js":  # rows from below
        theta = np.pi - theta
    begin = 0.5 * np.pi if engine in ("mitsuba", "materialx") else np.pi
    return from_spherical(theta, begin + phi)


@dataclass(frozen=True)
class Light:
    """One of the judged lights.

    Attributes:
        towards: where a distant lamp stands, unit vector (3,), z up; None for a soft light.
        is_white: whether it is the same from everywhere; else it is the studio.
    """

    towards: Array | None = None
    is_white: bool = False

    @classmethod
    def named(cls, name: str) -> Light:
        """By a name of `panel.JUDGED`."""
        kind, _, degrees = name.partition(" ")
        if kind != "sun":
            return cls(is_white=kind == "white")
        angle, right = np.deg2rad(float(degrees)), normalize(np.cross([0.0, 0.0, 1.0], ball_colours.VIEW))
        return cls(np.cos(angle) * ball_colours.VIEW + np.sin(angle) * right)

    def radiance(self, engine: str, rows: int = ROWS) -> Array:
        """Of a soft light as an engine lays it out, shape (rows, 2 rows)."""
        directions = layout(engine, rows)
        if self.is_white:
            return np.ones(directions.shape[:-1])
        return ball_colours.radiance_at(ball_colours.environment(), directions.reshape(-1, 3)).reshape(
            rows, -1
        )

    def irradiance(self, engine: str, rows: int = 32) -> Array:
        """Irradiance over pi of surfaces that face the directions of a layout, shape (rows, 2 rows)."""
        towards = layout(engine, 2 * rows).reshape(-1, 3)
        solid_angle = np.sqrt(1.0 - towards[:, 2] ** 2) * (0.5 * np.pi / rows) ** 2
        arriving = self.radiance(engine, 2 * rows).ravel() * solid_angle / np.pi
        return np.maximum(layout(engine, rows) @ towards.T, 0.0) @ arriving


LIGHTS = {name: Light.named(name) for name in panel.JUDGED}


@dataclass(frozen=True)
class Scene:
    """What engines draw.

    Attributes:
        shape: `ball` or `plane`.
        view: unit vector to the camera (3,), z up.
        size: pixels of a side.
        lights: by their names.
        finer: pixels across one, where an engine has no filter.
    """

    shape: str
    view: Array
    size: int
    lights: Mapping[str, Light]
    finer: int


BALL = Scene("ball", ball_colours.VIEW, SIZE, LIGHTS, 3)


def mitsuba(path: Path | None) -> Pictures:
    """Mitsuba's renders of a measured file, or of a white Lambertian for None."""
    mi = backend.mitsuba("rgb")
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    bsdf = white if path is None else {"type": "measured", "filename": str(path)}
    elevation_deg = float(np.rad2deg(np.arcsin(ball_colours.VIEW[2])))
    pictures = {}
    for name, light in LIGHTS.items():
        around = np.repeat(light.radiance("mitsuba")[..., None], 3, axis=2)
        scene = scenes.floating_ball(
            mi, bsdf, rgb_film(SIZE), around, elevation_deg=elevation_deg, margin=EDGE - 1.0
        )
        if light.towards is not None:
            scene["environment"] = {
                "type": "directional", "direction": (-light.towards).tolist(), "irradiance": np.pi,
            }  # fmt: skip
        samples = _SAMPLES if light.towards is None else 16
        pictures[name] = render_scene(mi, mi.load_dict(scene), RenderSettings(SIZE, samples))
    return pictures


def kept(folder: Path, name: str, draw: Callable[[], Pictures]) -> Pictures:
    """Pictures of a folder, drawn where they are not there."""
    folder.mkdir(parents=True, exist_ok=True)
    if not all((folder / f"{name} {key}.npy").exists() for key in LIGHTS):
        for key, picture in draw().items():
            np.save(folder / f"{name} {key}.npy", picture[::-1])
    return read(folder, name)


def read(folder: Path, name: str, lights: Iterable[str] = LIGHTS) -> Pictures:
    """Pictures that were written rows from below."""
    return {key: np.load(folder / f"{name} {key}.npy")[::-1, :, :3] for key in lights}


@cache
def _picture(light: str) -> ball_colours.Picture:
    """The sums over direction pairs that make a picture in a light; soft lights share their pairs."""
    if LIGHTS[light].towards is not None:
        return ball_colours.sun_ball(float(light.split()[1]), SIZE)
    white, world = ball_colours.white_ball(SIZE, _RINGS, _SPOKES)
    if LIGHTS[light].is_white:
        return white
    return white.under(ball_colours.radiance_at(ball_colours.environment(), world))


def by_quadrature(brdf: EvaluableBRDF) -> Pictures:
    """Pictures of a BRDF in linear sRGB, by the sums with which errors are printed."""
    pictures, values = {}, {}
    for name, light in LIGHTS.items():
        sums, kind = _picture(name), name if light.towards is not None else "soft"
        if kind not in values:
            values[kind] = brdf.eval(sums.wi, sums.wo)
        pictures[name] = np.zeros((SIZE, SIZE, 3))
        pictures[name][_pixels(name)] = xyz_to_srgb(sums.xyz(values[kind], brdf.bands))
    return pictures


def _pixels(light: str, within: float = 1.0) -> tuple[Array, Array]:
    """Rows and columns of the lit pixels of the ball within so many radii."""
    places = _picture(light).places
    assert places is not None
    inside = np.linalg.norm(places, axis=1) < within
    column, row = ((0.5 + 0.5 * places[inside] * [1.0, -1.0]) * SIZE).astype(int).T
    return row, column


def exposed(drawn: Mapping[str, Pictures], white: Pictures, name: str) -> dict[str, Pictures]:
    """Pictures at exposures that give the one of this name the mean of `white`: one of each soft light, one of suns."""
    scale = {}
    for key, light in LIGHTS.items():
        like = key if light.towards is None else next(k for k in LIGHTS if LIGHTS[k].towards is not None)
        scale[key] = white[like][_pixels(like, _RIM)].sum() / drawn[name][like][_pixels(like, _RIM)].sum()
    return {name: {key: scale[key] * p for key, p in pictures.items()} for name, pictures in drawn.items()}


def differences(pictures: Pictures, others: Pictures) -> dict[str, float]:
    """Mean CIEDE2000 over the lit pixels of the ball, by light."""
    found = {}
    for name in LIGHTS:
        xyz, xyz_star = (
            srgb_to_xyz(np.clip(each[name][_pixels(name, _RIM)], 0.0, 1.0)) for each in (pictures, others)
        )
        found[name] = float(delta_e_2000(xyz, xyz_star, srgb_to_xyz(np.ones(3))).mean())
    return found


def write_sheets(folder: Path, drawn: Mapping[str, Mapping[str, Pictures]]) -> None:
    """Draw a picture for each light: a row of balls for each source, a column for each material."""
    folder.mkdir(parents=True, exist_ok=True)
    for light in LIGHTS:
        rows = [
            np.concatenate([made[light] for made in pictures.values()], axis=1) for pictures in drawn.values()
        ]
        images.write_display(folder / f"{light}.png", encode_srgb(np.clip(np.concatenate(rows), 0.0, 1.0)))
