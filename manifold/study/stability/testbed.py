"""The test bed for failure modes: a family of materials with known ground truth, its libraries and models.

The family is a plastic (GGX boundary over a diffuse base) of any roughness and colour, in three bands, measured by
the virtual goniometer. Between two measured members lies a third one, whose true BRDF is known, so that every error
can be measured.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

import numpy as np

from manifold.analytic.ggx import GGX
from manifold.analytic.microfacet import Plastic
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import plausibility
from manifold.colour import ball_colours
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import delta_e_2000
from manifold.core.metrics import Errors, relative_error
from manifold.core.pairs import Pairs, RusinkiewiczGrid
from manifold.core.records import Array, Bands, BsdfFile
from manifold.evaluate.method_data import Data
from manifold.io_rgl import write_bsdf
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.latent_space import LatentSpace
from manifold.model.manifold import Manifold
from manifold.model.prediction import PredictedBRDF
from manifold.model.settings import KINDS, GplvmSettings

BANDS = Bands((450.0, 550.0, 650.0))
ALPHAS = (0.1, 0.17, 0.29, 0.5)
COLOURS = ((0.12, 0.2, 0.6), (0.5, 0.45, 0.4), (0.55, 0.3, 0.1))
GREY = (0.3, 0.3, 0.3)
MIDDLE = float(np.sqrt(ALPHAS[1] * ALPHAS[2]))  # a roughness between those of the family

_ETA = np.array(1.5)
_GRID = RusinkiewiczGrid(24, 12, 8)


def plastic(alpha: float, colour: Sequence[float] = GREY) -> Plastic:
    """Return a member of the family: GGX roughness alpha, diffuse reflectance per band."""
    return Plastic(GGX.isotropic(alpha), _ETA, np.array(colour), BANDS)


def named(alpha: float, colour: int) -> str:
    """Return the name of a member of the family."""
    return f"plastic_{alpha:g}_{colour}"


class TestBed:
    """Libraries, models and tables of the family, made on first use; a `with` block removes its files."""

    __test__ = False  # pytest takes classes of such names for tests

    def __init__(self) -> None:
        self._made: dict[Hashable, Any] = {}
        self._folder = TemporaryDirectory()

    def __enter__(self) -> TestBed:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def cached(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the cached result of `make`, which is called once per key."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def file(self, alpha: float, colour: Sequence[float] = GREY, name: str = "held_out") -> BsdfFile:
        """Return a member of the family as the goniometer measures it."""
        key = ("file", alpha, tuple(colour))
        return replace(self.cached(key, lambda: goniometer.measure(plastic(alpha, colour), name)), name=name)

    @cached_property
    def family(self) -> tuple[BsdfFile, ...]:
        """Twelve files: four roughnesses in three colours."""
        return tuple(
            self.file(alpha, colour, named(alpha, k)) for alpha in ALPHAS for k, colour in enumerate(COLOURS)
        )

    def library(self, files: Sequence[BsdfFile]) -> Path:
        """Write a new library of files."""
        folder = Path(mkdtemp(dir=self._folder.name))
        for file in files:
            write_bsdf(folder / f"{file.name}_spec.bsdf", file)
        import_files(folder / "library.zarr", [folder])
        return folder / "library.zarr"

    def fit(self, files: Sequence[BsdfFile], kind: str, **settings: Any) -> Manifold:
        """Fit a manifold to a new library of files; the family's library is shared."""
        is_family = len(files) == len(self.family) and all(map(operator.is_, files, self.family))
        path = self.cached("library", lambda: self.library(files)) if is_family else self.library(files)
        return Manifold.fit(Library.open(path), KINDS[kind](**settings), calibrate=False)

    def model(self, kind: str, **settings: Any) -> Manifold:
        """Return the manifold of the family, which must not be changed."""
        key = ("model", kind, *settings.items())
        return self.cached(key, lambda: self.fit(self.family, kind, **settings))

    @cached_property
    def data(self) -> Data:
        """Measured values of the family on a coarse grid."""
        return Data.evaluate([MeasuredBRDF(file) for file in self.family], _GRID)

    @cached_property
    def pairs(self) -> Pairs:
        """Direction pairs at which errors are measured; they differ from the pairs at which materials are located."""
        return _GRID.pairs()

    def error(self, found: BRDF, truth: BRDF) -> float:
        """Return the relative error, weighted by both cosines."""
        wi, wo = self.pairs.wi, self.pairs.wo
        return relative_error(truth.eval(wi, wo), found.eval(wi, wo), self.pairs.cosines)

    def ball_difference(self, found: BRDF, truth: BRDF, *, is_turned: bool = True) -> float:
        """Return the mean CIEDE2000 between two materials in the family's bands.

        With `is_turned`, the light is turned to a direction that no diagnostic uses.
        """
        ball = ball_colours.ball(turned_deg=180.0 * is_turned)
        return ball.difference(found.eval(ball.wi, ball.wo), truth.eval(ball.wi, ball.wo), BANDS)

    def embed(self, model: Manifold, material: BRDF) -> tuple[PredictedBRDF, tuple[str, ...]]:
        """Return the prediction of a manifold for a new material, and its diagnostics."""
        found = model.embed(material)
        brdf, messages = predict(model, found.latent, found.colours)
        errors = Errors(self.ball_difference(brdf, material, is_turned=False), linear=found.relative_error)
        return brdf, diagnostics.of_embedding(errors) + messages

    @cached_property
    def _plastics(self) -> list[tuple[Array, Array]]:
        """Return f of the black plastic on the ball, and the part that a white base adds, (P, B) each.

        There is one pair per roughness.
        """
        ball = ball_colours.ball()
        black_and_white = (
            [plastic(alpha, [c] * BANDS.count).eval(ball.wi, ball.wo) for c in (0.0, 1.0)]
            for alpha in np.geomspace(0.03, 1.2, 40)
        )
        return [(black, white - black) for black, white in black_and_white]

    def ball_difference_to_plastics(self, found: BRDF) -> float:
        """Return the mean CIEDE2000 between a material's ball and that of the nearest plastic.

        The plastic may have any roughness and colour.
        """
        ball = ball_colours.ball()
        f, light = found.eval(ball.wi, ball.wo), ball.light
        nearest = []
        for black, base in self._plastics:
            lit = light[:, None] * base
            colour = np.einsum("pb,pb->b", lit, f - black) / np.einsum("pb,pb->b", lit, base)
            nearest.append(ball.xyz(black + np.clip(colour, 0.0, 1.0) * base, BANDS))
        # [roughnesses, K, 3]: together, since colour-science takes longest to be called
        xyz = np.stack(nearest)
        white = srgb_to_xyz(np.ones(3))
        return float(delta_e_2000(ball.xyz(f, BANDS)[None], xyz, white).mean(axis=1).min())


def in_space(model: Manifold, space: LatentSpace) -> Manifold:
    """Return a manifold of the same materials with other latents, or another kernel on them."""
    settings = replace(model.settings, length_scale=space.kernel.length_scale)
    if isinstance(settings, GplvmSettings):
        settings = replace(settings, mu=space.kernel.mu)
    return Manifold(model.materials, space, settings, {})


def predict(
    model: Manifold, x: Array, colours: Array | None = None, residual: float = 0.0
) -> tuple[PredictedBRDF, tuple[str, ...]]:
    """Predict at a latent of a manifold; return the BRDF and its diagnostics.

    `residual` is the argument of `diagnostics.of_prediction`.
    """
    brdf = model.predict(x, colours)
    is_extrapolation = bool(model.is_extrapolation(x, colours))
    return brdf, diagnostics.of_prediction(is_extrapolation, plausibility(brdf), residual)
