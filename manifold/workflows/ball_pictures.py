"""One function per command that draws rendered balls: the map and the walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold.brdf.measured import BRDF
from manifold.errors import UsageError
from manifold.model import diagnostics
from manifold.model.colours import NEAREST, UNCHOSEN, ColourChoice
from manifold.model.diagnostics import Diagnosis
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.plots import figures, plot_balls, plot_latents
from manifold.records import Array, Progress
from manifold.rendering import backend, thumbnails
from manifold.rendering.thumbnails import cropped

MOST_STEPS = 25


@dataclass(frozen=True, eq=False)
class DrawnMap:
    """A map that was drawn.

    Attributes:
        left_out: rendered balls, where Mitsuba is missing; materials are points then.
        diagnosis: of the prediction that is marked, if one is.
        marked: the latent of that prediction, shape (Q,).
    """

    left_out: tuple[str, ...]
    diagnosis: Diagnosis | None
    marked: Array | None


@dataclass(frozen=True)
class Step:
    """A prediction on a path, at t from 0 to 1."""

    t: float
    diagnosis: Diagnosis

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"t": self.t} | self.diagnosis.to_json()


def latent_map(
    model: Path,
    output: Path,
    *,
    library: Path | None = None,
    marked: Place | None = None,
    colour: ColourChoice = NEAREST,
    on_progress: Progress | None = None,
) -> DrawnMap:
    """Draw the map of latents with a rendered ball per material, and with one of a prediction.

    Args:
        model: path of a model.
        output: the picture.
        library: where the model's library is now, if not where the model remembers it.
        marked: place of a prediction to show.
        colour: of that prediction, on a monochrome manifold.
        on_progress: called with (done, total, what) while balls are rendered for the first time.
    """
    figures.require_writable(output)
    loaded = Manifold.load(model, library)
    x, predicted, diagnosis = None, None, None
    if marked is not None:
        x, predicted, diagnosis = diagnostics.predict_and_diagnose(loaded, marked, colour)
    if not backend.is_available():
        figures.save(plot_latents.latent_map(loaded, marked=x), output)
        return DrawnMap(("rendered balls, since Mitsuba is missing",), diagnosis, x)
    ball = None if predicted is None else cropped(thumbnails.of_material(predicted))
    balls = [cropped(image) for image in thumbnails.of_materials(loaded, on_progress)]
    figures.save(plot_balls.ball_map(loaded, balls, x, ball), output)
    return DrawnMap((), diagnosis, x)


def walk(
    model: Path,
    start: str,
    end: str,
    output: Path,
    *,
    steps: int = 7,
    library: Path | None = None,
    on_progress: Progress | None = None,
) -> tuple[Step, ...]:
    """Draw the path between two materials: along the manifold, and by linear interpolation (Hikichi & Iwasaki, eq. 23).

    Along the manifold of blends, there is a row in reflectances between the two, and one in the colours of the latents.

    Returns:
        What is to be known of the predictions between the materials; those with diagnostics are marked in the picture.
    Raises:
        UsageError: a material is unknown, or there are fewer than 2 or more than 25 steps.
        RendererError: Mitsuba is missing.
    """
    if not 2 <= steps <= MOST_STEPS:
        raise UsageError(f"{steps} steps, expected 2 to {MOST_STEPS}")
    figures.require_writable(output)
    backend.choose()
    loaded = Manifold.load(model, library)
    t = np.linspace(0.0, 1.0, steps)
    methods: list[tuple[str, Callable[[float], BRDF]]] = [
        ("manifold", lambda value: loaded.interpolate(start, end, value)),
        ("linear", lambda value: loaded.blend(start, end, value)),
    ]
    if loaded.space.takes_colours and not loaded.space.needs_colours:
        methods.insert(
            1, ("manifold,\nits colours", lambda value: loaded.predict(loaded.between(start, end, value)))
        )
    rows: list[tuple[str, list[Array]]] = []
    between: list[Step] = []
    for name, along in methods:
        images: list[Array] = []
        for value in t.tolist():
            brdf = along(value)
            images.append(cropped(thumbnails.of_material(brdf)))
            if not rows and 0.0 < value < 1.0:
                found = diagnostics.of_brdf(loaded, loaded.between(start, end, value), brdf, UNCHOSEN)
                between.append(Step(value, found))
            if on_progress is not None:
                done = len(rows) * steps + len(images)
                on_progress(done, len(methods) * steps, f"{name}, t = {value:.2g}".replace("\n", " "))
        rows.append((name, images))
    is_doubtful = {step.t: bool(step.diagnosis.diagnostics) for step in between}
    doubtful = [is_doubtful.get(value, False) for value in t.tolist()]
    title = f"From {figures.shortened(start)} to {figures.shortened(end)}"
    figures.save(plot_balls.walk_strip(title, t.tolist(), rows, doubtful), output)
    return tuple(between)
