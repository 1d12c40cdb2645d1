"""A library's atoms and photographs of one of its materials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.small_library import measured

from manifold.colour.lights import environment
from manifold.estimate import photographs, reports
from manifold.estimate.atoms import LibraryAtoms
from manifold.io_rgl import write_bsdf
from manifold.render.render import render_floating_ball


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch) -> None:
    """Reports and pictures of photographs in fewer pixels, with fewer samples: no test looks at their noise."""
    monkeypatch.setattr(reports, "_BALL", 64)
    monkeypatch.setattr(photographs, "_SIZE", 128)
    monkeypatch.setattr(photographs, "_SAMPLES", 8)


@pytest.fixture(scope="session")
def photo_atoms(atoms) -> LibraryAtoms:
    """Those of the small library, as pixels see them."""
    return atoms.in_values


@pytest.fixture(scope="session")
def render(tmp_path_factory):
    """A ball of a material of the corpus in an environment made here: linear, 1 % noise, shape (size, size, 3)."""
    folder = tmp_path_factory.mktemp("balls")

    def ball(name: str, light: str, size: int = 96, margin: float = 0.3) -> np.ndarray:
        path: Path = folder / f"{name}_rgb.bsdf"
        write_bsdf(path, measured(name))
        picture = render_floating_ball(
            path,
            True,
            environment(light, 128),
            size=size,
            samples=32,
            margin=margin,
            elevation_deg=15.0,
            distance=8.0,
        )
        return picture * (1.0 + 0.01 * np.random.default_rng(0).standard_normal(picture.shape))

    return ball
