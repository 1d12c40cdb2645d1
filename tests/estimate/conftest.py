"""A library's atoms and photographs of one of its materials."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.quick_fits import fit_quickly
from helpers.quick_pictures import draw_quickly
from helpers.small_library import measured

from manifold.colour.lights import environment
from manifold.estimate import photographs, sightings
from manifold.estimate.atoms import LibraryAtoms
from manifold.io_rgl import write_bsdf
from manifold.render.render import render_floating_ball


@pytest.fixture(scope="module", autouse=True)
def small_pictures() -> Iterator[None]:
    """Pictures in fewer pixels, with fewer samples, and fewer directions of light for each block of a photograph: no
    test looks at their noise.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photographs, "_SIZE", 128)
        patch.setattr(photographs, "_SAMPLES", 8)
        patch.setattr(sightings, "SAMPLES", 128)
        draw_quickly(patch)
        fit_quickly(patch)
        yield


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
