"""Predictions written as RGL files, and what is known of them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__, atomic
from manifold.brdf import goniometer
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.physical import PhysicalBRDF
from manifold.brdf.plausibility import Plausibility, plausibility
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.io_rgl import material_name, write_bsdf
from manifold.model import diagnostics
from manifold.model.colours import NEAREST, ColourChoice, choose_colour
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.model.prediction import ClippedBRDF
from manifold.records import Array, Progress

PREDICTED = "Predicted at latent"
"""How the descriptions of predicted files begin."""

_FILE_INCIDENCES_DEG = (0.0, 30.0, 60.0, 75.0, 80.0, 85.0)  # where the albedo of a written file is looked at


@dataclass(frozen=True)
class Prediction:
    """A predicted material and what is known of it.

    Attributes:
        latent: where it lies, shape (Q,).
        coordinates: the same, in digits that give the prediction back.
        path: the written file.
        colour: where the colour comes from, in words; None where the latent carries it.
        reflectance_missed: largest distance over bands of the reflectance asked for from the one reached.
        is_physical: whether it was projected to be reciprocal and to return no more light than it gets.
        std: posterior standard deviation as a fraction of the prior's, 0 to 1.
        is_extrapolation: whether the data say little at this latent.
        nearest: the three nearest materials with their distances.
        weights: the materials with the largest weights, by magnitude, in this colour.
        plausibility: of the prediction, before negative values are clipped for the file.
        file_albedo: largest directional albedo of the written file, over bands and incidences.
        diagnostics: what a user should know before trusting it, in sentences.
        clipped_share: share of the file's values that were negative and became zero.
        seconds: evaluating and writing, without loading the library.
    """

    latent: tuple[float, ...]
    coordinates: tuple[str, ...]
    path: Path
    colour: str | None
    reflectance_missed: float
    is_physical: bool
    std: float
    is_extrapolation: bool
    nearest: tuple[tuple[str, float], ...]
    weights: tuple[tuple[str, float], ...]
    plausibility: Plausibility
    file_albedo: float
    diagnostics: tuple[str, ...]
    clipped_share: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        content = dict(vars(self))
        content |= {"path": str(self.path), "plausibility": vars(self.plausibility)}
        return {"program": f"manifold {__version__}", **content}


def predict(
    model: Manifold | Path,
    latent: Place,
    output: Path,
    *,
    library: Path | None = None,
    colour: ColourChoice = NEAREST,
    physical: bool = False,
    resolution: int = 32,
    n_theta_i: int = 8,
    on_progress: Progress | None = None,
) -> Prediction:
    """Predict the material at a latent and write it as an RGL file.

    Args:
        model: a fitted manifold, or the path of one.
        latent: Q coordinates, or the name of a material.
        output: the file to write; its name becomes the material's.
        library: where the model's library is now, if not where the model remembers it.
        colour: of a monochrome manifold, whose latent is the structure alone.
        physical: project to non-negative, reciprocal, and albedo at most 1.
        resolution: nodes per axis of the outgoing grid.
        n_theta_i: incident elevations.
        on_progress: called while measured materials are read.
    Raises:
        UsageError: the name of the output does not end in `.bsdf`, or the file cannot be written.
        LatentError: the latent does not have Q finite coordinates.
    """
    name = material_name(output)
    if output.suffix != ".bsdf" or not name:
        raise UsageError(f"{output}: predictions are written as .bsdf files; name one with -o NAME.bsdf")
    atomic.require_writable(output)
    if isinstance(model, Path):
        model = Manifold.load(model, library)
    x = model.require_latent(latent)
    model.prepare(on_progress)
    start = time.perf_counter()
    chosen = choose_colour(model, x, colour)
    brdf = model.predict(x, chosen.colours)
    clipped = ClippedBRDF(PhysicalBRDF(brdf) if physical else brdf)
    file = goniometer.measure(
        clipped,
        name,
        description=_describe(model, x, chosen.words, physical),
        resolution=resolution,
        n_theta_i=n_theta_i,
        version=(1, 0) if model.bands.is_rgb else (3, 1),
    )
    write_bsdf(output, file)
    seconds = time.perf_counter() - start
    found = plausibility(clipped if physical else brdf)
    incident = from_spherical(np.deg2rad(_FILE_INCIDENCES_DEG), 0.0)
    file_albedo = float(MeasuredBRDF(file).albedo(incident).max())
    is_extrapolation = bool(model.is_extrapolation(x, chosen.colours))
    return Prediction(
        latent=tuple(float(v) for v in x),
        coordinates=model.space.printed(x),
        path=output,
        colour=chosen.words,
        reflectance_missed=chosen.missed,
        is_physical=physical,
        std=float(model.std(x, chosen.colours)),
        is_extrapolation=is_extrapolation,
        nearest=tuple(model.nearest(x, 3)),
        weights=tuple(model.largest_weights(x, 5, chosen.colours)),
        plausibility=found,
        file_albedo=file_albedo,
        diagnostics=diagnostics.of_prediction(is_extrapolation, found, chosen.missed)
        + diagnostics.of_file(found.max_albedo, file_albedo)
        + diagnostics.of_unmeasured(model.unmeasured_share(x)),
        clipped_share=clipped.clipped_share,
        seconds=seconds,
    )


def _describe(model: Manifold, x: Array, colour: str | None, physical: bool) -> str:
    """What a predicted file says about itself."""
    synthetic = any(model.library.attributes(name).is_synthetic for name in model.names)
    origin = "a synthetic corpus" if synthetic else f"{len(model.names)} measured materials"
    at = ", ".join(model.space.printed(x))
    how = (f", coloured {colour}" if colour else "") + ", projected to be physical" * physical
    return f"{PREDICTED} ({at}){how} from {origin} by manifold {__version__}"
