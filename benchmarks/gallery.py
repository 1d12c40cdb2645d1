"""Pictures of a map at random latents: predictions, walks, and chosen colours.

    python benchmarks/gallery.py MODEL.h5 --figures FOLDER [--seed 0]

Nine latents on a 3 x 3 grid of the map's extent, each moved to the nearest place inside the hull of the materials;
walks between ten random pairs of materials; five colours at five random places inside the hull. Rendered by Mitsuba,
and nothing is left out: what a prediction's diagnostics say stands under it.
"""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import Delaunay

from manifold.core.records import Array
from manifold.model import diagnostics
from manifold.model.colours import UNCHOSEN, ChosenColour, ColourChoice
from manifold.model.manifold import Manifold
from manifold.model.places import Place
from manifold.pictures import figures
from manifold.render import thumbnails

COLOURS = ("#b03030", "#d0a020", "#308040", "#2050a0", "#e8e4dc")
PLACES, WALKS, STEPS = 5, 10, 7
_INK = "#a02020"
_LETTERS = 24  # of a line under a ball

Cell = tuple[Array, str]
"""A ball, RGBA (H, W, 4), and what is written under it."""


class Gallery:
    """Balls of predictions of a model, with what speaks against them."""

    def __init__(self, model: Manifold, seed: int) -> None:
        self._model, self._rng = model, np.random.default_rng(seed)
        self._hull = Delaunay(model.X)

    def across(self) -> list[list[Cell]]:
        """Nine latents over the map's extent, the first two dimensions varied."""
        low, high = self._model.X.min(axis=0), self._model.X.max(axis=0)
        rows = []
        for v in (0.8, 0.5, 0.2):
            asked = [low + (high - low) * np.r_[u, v, [0.5] * (len(low) - 2)] for u in (0.2, 0.5, 0.8)]
            rows.append([self._cell(self._inside(x)) for x in asked])
        return rows

    def walks(self) -> list[list[Cell]]:
        """From one random material to another, along the manifold."""
        rows = []
        for _ in range(WALKS):
            start, end = self._rng.choice(self._model.names, 2, replace=False).tolist()
            row = []
            for t in np.linspace(0.0, 1.0, STEPS).tolist():
                brdf = self._model.interpolate(start, end, t)
                name = {0.0: start, 1.0: end}.get(t, "")
                found = diagnostics.diagnose(self._model, Place(self._model.between(start, end, t)), brdf)
                row.append((thumbnails.of_material(brdf), _caption(name, found.diagnostics)))
            rows.append(row)
        return rows

    def colours(self) -> list[list[Cell]]:
        """Random places inside the hull, each in five colours."""
        rows = []
        for _ in range(PLACES):
            x = self._inside(self._rng.uniform(self._model.X.min(axis=0), self._model.X.max(axis=0)))
            chosen = [self._model.choose_colour(x, ColourChoice(srgb=colour)) for colour in COLOURS]
            rows.append([self._cell(x, c, name) for c, name in zip(chosen, COLOURS, strict=True)])
        return rows

    def _cell(self, x: Array, chosen: ChosenColour = UNCHOSEN, name: str = "") -> Cell:
        brdf = self._model.predict(x, chosen.colours)
        found = diagnostics.diagnose(self._model, Place(x), brdf, chosen)
        return thumbnails.of_material(brdf), _caption(
            name or ", ".join(f"{v:.1f}" for v in x), found.diagnostics
        )

    def _inside(self, x: Array) -> Array:
        """The point of the hull that is nearest to x (Q,): a convex combination of the materials."""
        if self._hull.find_simplex(x) >= 0:
            return x
        X = self._model.X
        weights, _ = nnls(np.vstack([X.T, np.full(len(X), 1e3)]), np.r_[x, 1e3])  # 1e3: their sum is 1
        return weights / weights.sum() @ X


def _caption(name: str, sentences: tuple[str, ...]) -> str:
    lines = [line for sentence in sentences for line in textwrap.wrap(sentence.split(":")[0], _LETTERS)]
    return "\n".join([name.removeprefix("syn_"), *lines])


def draw(rows: list[list[Cell]], path: Path) -> None:
    """A grid of balls as a picture."""
    figure = figures.new_figure(1.35 * len(rows[0]), 1.75 * len(rows))
    for axes_row, row in zip(figure.subplots(len(rows), len(rows[0]), squeeze=False), rows, strict=True):
        for axes, (image, caption) in zip(axes_row, row, strict=True):
            axes.imshow(image, interpolation="antialiased")
            axes.set_axis_off()
            axes.set_title(caption, y=-0.16, va="top", fontsize=6, color=_INK if "\n" in caption else "0.2")
    figures.save(figure, path)


def main() -> None:
    """Draw the three pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--figures", type=Path, default=Path())
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    gallery = Gallery(Manifold.load(given.model), given.seed)
    for name, made in (("latents", gallery.across), ("walks", gallery.walks), ("colours", gallery.colours)):
        rows = made()
        draw(rows, given.figures / f"inside-{name}.png")
        doubtful = sum("\n" in caption for row in rows for _, caption in row)
        print(f"{name}: {sum(map(len, rows))} balls, {doubtful} with diagnostics", flush=True)


if __name__ == "__main__":
    main()
