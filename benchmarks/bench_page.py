"""The page of a map in headless Chromium: its balls against Mitsuba, the time of a drag, and of the first picture.

    python benchmarks/bench_page.py MODEL [--count 10] [--seed 0] [--samples 512] [--direct] [--picture FILE]

Balls: predictions at random places between four materials each, and beside five of the least glossy materials, as the
page shows them at rest, against renders of the same in Mitsuba: a sphere that floats in the page's studio, seen from
where the page sees it, of the `.bsdf` of the
prediction and, with `--direct`, of the measured materials evaluated while rendering. Mean CIEDE2000 over the ball, of
pictures without tone mapping; beside it that of two renders with other noise. Steps of a drag on the map, and of the
light that is turned: the main thread from the change on, and until a pixel is read back, so that WebGL has finished;
the ball is drawn at 256 x 256.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.browser import chromium, visit

from manifold.colour import ball_colours
from manifold.colour.conversion import decode_srgb, sensor_responses, srgb_to_xyz, xyz_to_srgb
from manifold.colour.illuminants import Illuminant
from manifold.colour.lights import environment
from manifold.core.directions import from_spherical
from manifold.core.records import Array
from manifold.estimate import predictions
from manifold.estimate.gloss import gloss_units
from manifold.model.manifold import Manifold
from manifold.page import explore
from manifold.render import backend, images
from manifold.render.render import RenderSettings, colorimetric_film, render_scene, rgb_film

SIZE = 128
_EDGE = 1.02  # radii of the ball that half the side of the page's picture shows
_ENVIRONMENT_ROWS = 512
_BLEND_OF = 4
_DIFFUSE = 5


@dataclass(frozen=True)
class BallErrors:
    """Mean CIEDE2000 of the page's ball at a place.

    Attributes:
        file: against a render of the predicted file.
        noise: between two such renders.
        direct: against one that evaluates the measured materials, if that was asked for.
        pictures: of the page and of the renders, linear sRGB (SIZE, SIZE, 3).
    """

    file: float
    noise: float
    direct: float | None
    pictures: list[Array]


def mitsuba_ball(material: Mapping[str, Any], is_rgb: bool, samples: int, seed: int = 0) -> Array:
    """A sphere in the page's studio, seen from `ball_colours.VIEW` by parallel rays; linear sRGB."""
    settings = RenderSettings(SIZE, samples, seed)
    mi = backend.mitsuba("rgb" if is_rgb else "spectral")
    film = rgb_film(SIZE) if is_rgb else colorimetric_film(mi, SIZE, settings.illuminant)
    transform = mi.ScalarTransform4f
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": {
            "type": "orthographic",
            "to_world": transform().look_at(
                origin=(4.0 * ball_colours.VIEW).tolist(), target=[0, 0, 0], up=[0, 0, 1]
            ).scale([_EDGE, _EDGE, 1.0]),
            "film": film,
            "sampler": {"type": "multijitter"},
        },
        "environment": {
            "type": "envmap", "bitmap": mi.Bitmap(_environment()), "to_world": transform().rotate([1, 0, 0], 90),
        },
        "ball": {"type": "sphere", "material": dict(material)},
    })  # fmt: skip
    picture = render_scene(mi, scene, settings)
    return (
        picture if is_rgb else xyz_to_srgb(picture, sensor_responses(Illuminant.named("D65"))[1].sum(axis=0))
    )


def _environment() -> Array:
    """The page's studio in fine cells, whose interpolation by renderers no longer matters."""
    rows = _ENVIRONMENT_ROWS
    theta = np.pi * np.arange(rows) / (rows - 1)  # Mitsuba's first and last rows are the poles
    azimuth = 2.0 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows)
    directions = from_spherical(theta[:, None], np.pi / 2 - azimuth[None])
    grey = ball_colours.radiance_at(environment("studio"), directions.reshape(-1, 3))
    return np.repeat(grey.reshape(rows, 2 * rows, 1), 3, axis=2).astype(np.float32)


def page_ball(page: Any, x: Array) -> Array:
    """The page's ball at rest at a place x (Q,), sRGB values and alpha in [0, 1], shape (SIZE, SIZE, 4)."""
    script = """([x, size]) => {
      const { explorer } = window;
      explorer.change({ x });
      explorer.refresh();
      explorer.balls.refine(0);
      return [...explorer.balls.image(0, size).data];
    }"""
    return np.array(page.evaluate(script, [x.tolist(), SIZE])).reshape(SIZE, SIZE, 4) / 255.0


def compare_balls(
    page: Any, model: Manifold, x: Array, samples: int, direct: Path | None = None
) -> BallErrors:
    """The page's ball at a place x (Q,) against Mitsuba's; `direct` is the model's file, where that is asked for."""
    shown, is_rgb = page_ball(page, x), model.bands.is_rgb
    is_whole = shown[..., 3] == 1.0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "predicted.bsdf"
        predictions.predict(model, x, file)
        measured = {"type": "measured", "filename": str(file)}
        renders = [mitsuba_ball(measured, is_rgb, samples, seed) for seed in (0, 1)]
    pictures = [decode_srgb(shown[..., :3]), 0.5 * (renders[0] + renders[1])]
    if direct is not None:
        latent = ",".join(repr(float(v)) for v in x)
        material = {
            "type": "manifold",
            "model": str(direct),
            "latent": latent,
            "library": str(model.library.path),
        }
        pictures.append(mitsuba_ball(material, is_rgb, samples))

    def delta_e(a: Array, b: Array) -> float:
        return ball_colours.delta_e(*(srgb_to_xyz(np.clip(c[is_whole], 0.0, 1.0)) for c in (a, b)))

    evaluated = None if direct is None else delta_e(pictures[0], pictures[2])
    return BallErrors(delta_e(*pictures[:2]), delta_e(*renders), evaluated, pictures)


def places(model: Manifold, count: int, seed: int) -> Array:
    """Random places between four random materials each, shape (count, Q)."""
    rng, n = np.random.default_rng(seed), len(model.names)
    return np.stack([
        rng.dirichlet(np.ones(min(_BLEND_OF, n))) @ model.X[rng.choice(n, min(_BLEND_OF, n), replace=False)]
        for _ in range(count)
    ])  # fmt: skip


def diffuse_places(model: Manifold, count: int) -> Array:
    """Places beside the materials of least gloss, each a tenth of the way to the next, shape (count, Q)."""
    gloss = [gloss_units(model.material(name), (60.0,))[60.0] for name in model.names]
    least = np.argsort(gloss)[: count + 1]
    return 0.9 * model.X[least[:-1]] + 0.1 * model.X[least[1:]]


STEPS = {
    "drag": """const { low, high } = explorer.map, x = [...explorer.state.x];
      for (const q of [0, 1]) x[q] = low[q] + (high[q] - low[q]) * (0.5 + 0.4 * Math.sin((q + 2) * 3 * t));
      const change = { x, at: undefined, path: null };""",
    "turn": "const change = { turn: 360 * t };",
}
"""What changes from step to step, t from 0 to 1: the place on the map, or the azimuth of the light."""


def step_ms(page: Any, change: str, steps: int = 100) -> dict[str, dict[str, float]]:
    """Time of a step in ms, of the main thread and until WebGL has drawn too."""
    script = """(steps) => {
      const { explorer } = window, times = [], before = { ...explorer.state };
      const gl = explorer.balls.gl, pixel = new Uint8Array(4);
      for (let k = 0; k < steps; k++) {
        const t = k / steps;
        CHANGE
        const began = performance.now();
        Object.assign(explorer.state, change);
        explorer.refresh();
        const done = performance.now();
        gl.readPixels(1, 1, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        times.push([done - began, performance.now() - began]);
      }
      Object.assign(explorer.state, before);
      explorer.refresh();
      return times;
    }""".replace("CHANGE", change)
    page.evaluate("Object.assign(document.getElementById('ball').style, { width: '256px', height: '256px' })")
    times = np.array(page.evaluate(script, steps)).T
    return {
        kind: dict(zip(("least", "median", "p95"), np.percentile(values, [0, 50, 95]).tolist(), strict=True))
        for kind, values in zip(("main_thread", "until_drawn"), times, strict=True)
    }


def main() -> None:
    """Print the figures, and keep them where asked to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=512)
    parser.add_argument("--direct", action="store_true", help="evaluate the measured materials, too")
    parser.add_argument("--picture", type=Path, help="page and renders, row by row")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    model = Manifold.load(given.model)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        html = Path(folder) / "map.html"
        size = explore.write_page(given.model, html)
        page = visit(browser, html.as_uri()).page
        first = float(page.evaluate("document.body.dataset.ready"))
        page.wait_for_selector("[data-complete]", state="attached")
        steps = {f"{name}_ms": step_ms(page, change) for name, change in STEPS.items()}
        found, diffuse = (
            [
                compare_balls(page, model, x, given.samples, given.model if given.direct else None)
                for x in where
            ]
            for where in (places(model, given.count, given.seed), diffuse_places(model, _DIFFUSE))
        )
    figures: dict[str, Any] = {"bytes": size, "first_picture_ms": first, **steps}
    for kind in ("file", "noise", *["direct"] * given.direct):
        for which, of in (("", found), ("_diffuse", diffuse)):
            errors = [getattr(errors, kind) for errors in of]
            figures[f"ciede2000_{kind}{which}"] = {
                "mean": float(np.mean(errors)),
                "most": max(errors),
                "each": errors,
            }
    print(json.dumps(figures, indent=1))
    if given.picture is not None:
        images.write_image(given.picture, np.vstack([np.hstack(e.pictures) for e in found + diffuse]))
    if given.json is not None:
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
