"""Predictions written as RGL files, with their diagnostics."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from manifold import __version__
from manifold.brdf.plausibility import Plausibility
from manifold.model import diagnostics
from manifold.model.checked_file import require_bsdf_output, write_checked
from manifold.model.colours import NEAREST, ColourChoice, choose_colour
from manifold.model.diagnostics import Diagnosis
from manifold.model.latents import Place
from manifold.model.manifold import Manifold
from manifold.model.prediction import ClippedBRDF
from manifold.records import Array, Progress
from manifold.system.stages import Stages

PREDICTED = "Predicted at latent"
"""First words of the description of a predicted file."""


@dataclass(frozen=True)
class Prediction:
    """A predicted material, its file and its diagnostics.

    Attributes:
        latent: its latent, shape (Q,).
        coordinates: the same, with the digits that reproduce the prediction.
        path: the written file.
        colour: where the colour comes from, in words; None where the latent fixes it.
        is_physical: whether it was projected to be non-negative, reciprocal and energy-conserving.
        weights: the materials with the largest weights, by magnitude, in this colour.
        clipped_share: share of the predicted values that were negative, and are zero in the file.
        diagnosis: expected errors, measurements on the written file, and diagnostics.
        seconds: evaluating, checking and writing, without loading the library.
    """

    latent: tuple[float, ...]
    coordinates: tuple[str, ...]
    path: Path
    colour: str | None
    is_physical: bool
    weights: tuple[tuple[str, float], ...]
    clipped_share: float
    diagnosis: Diagnosis
    seconds: float

    @property
    def plausibility(self) -> Plausibility:
        """Of the written file."""
        return self.diagnosis.plausibility

    @property
    def diagnostics(self) -> tuple[str, ...]:
        """Defects found, as sentences."""
        return self.diagnosis.diagnostics

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        content = dict(vars(self)) | {"path": str(self.path)} | self.diagnosis.to_json()
        del content["diagnosis"]
        return {"program": f"manifold {__version__}", **content}


def predict(
    model: Manifold | Path | str,
    latent: Place,
    output: Path | str,
    *,
    library: Path | str | None = None,
    colour: ColourChoice = NEAREST,
    physical: bool = False,
    force: bool = False,
    resolution: int = 32,
    n_theta_i: int = 8,
    on_progress: Progress | None = None,
) -> Prediction:
    """Predict the material at a latent and write it as an RGL file.

    Args:
        model: a fitted manifold, or the path of one.
        latent: Q coordinates, or another `Place`.
        output: the file to write; its name becomes the material's.
        library: where the model's library is now, if not where the model remembers it.
        colour: of a monochrome manifold, whose latent is the structure alone.
        physical: project the file to non-negative, reciprocal within 5 %, and albedo at most 1.
        force: also write a file whose albedo exceeds 1.05.
        resolution: nodes per axis of the outgoing grid; with `physical`, at least.
        n_theta_i: incident elevations; with `physical`, at least.
        on_progress: called with how much is done.
    Raises:
        UsageError: the name of the output does not end in `.bsdf`, the file cannot be written, or its albedo
            would exceed 1.05.
        LatentError: the latent does not have Q finite coordinates.
    """
    output = Path(output)
    require_bsdf_output(output, "predictions")
    if not isinstance(model, Manifold):
        model = Manifold.load(model, library)
    x = model.require_latent(latent)
    stages = Stages(on_progress, {"reading materials": 4, "writing": 1})
    model.prepare(stages.begin("reading materials"), x if colour == NEAREST else None)
    start = time.perf_counter()
    chosen = choose_colour(model, latent, colour)
    clipped = ClippedBRDF(model.predict(latent, chosen.colours))
    stages.begin("writing")
    found = write_checked(
        output,
        clipped,
        description=_describe(model, x, chosen.words, physical),
        remedy="scale it with --physical, write more --incidences",
        physical=physical,
        force=force,
        resolution=resolution,
        n_theta_i=n_theta_i,
    )
    seconds = time.perf_counter() - start
    diagnosis = diagnostics.diagnose(
        model, x, found, colours=chosen.colours, missed=chosen.missed, negative_share=clipped.clipped_share
    )
    if physical:
        sentences = diagnosis.diagnostics + diagnostics.of_projection(found)
        diagnosis = replace(diagnosis, diagnostics=sentences)
    return Prediction(
        latent=tuple(float(v) for v in x),
        coordinates=model.space.printed(x),
        path=output,
        colour=chosen.words,
        is_physical=physical,
        weights=tuple(model.largest_weights(x, 5, chosen.colours)),
        clipped_share=clipped.clipped_share,
        diagnosis=diagnosis,
        seconds=seconds,
    )


def _describe(model: Manifold, x: Array, colour: str | None, physical: bool) -> str:
    """The description in a predicted file."""
    synthetic = any(model.library.attributes(name).is_synthetic for name in model.names)
    origin = "a synthetic corpus" if synthetic else f"{len(model.names)} measured materials"
    at = ", ".join(model.space.printed(x))
    how = (f", colour {colour}" if colour else "") + ", projected to be physical" * physical
    return f"{PREDICTED} ({at}){how}{',' * bool(how)} from {origin} by manifold {__version__}"
