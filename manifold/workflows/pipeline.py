"""One function per command: paths in, paths and results out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manifold import __version__, atomic, cautions, gonio
from manifold.brdf import MeasuredBRDF
from manifold.colour_choice import NEAREST, ColourChoice, choose_colour
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.evaluation import selection
from manifold.evaluation.report import Report, make_report
from manifold.evaluation.selection import Candidate
from manifold.holes import close_holes, find_holes, share_of_holes
from manifold.io_rgl import material_name, read_bsdf, write_bsdf
from manifold.library.importing import ImportResult, import_files
from manifold.library.store import Library
from manifold.model import Manifold, Settings
from manifold.physical import PhysicalBRDF
from manifold.plausibility import Plausibility, plausibility
from manifold.plots import figures, plot_latents
from manifold.prediction import ClippedBRDF
from manifold.records import Array, Progress
from manifold.synthetic import corpus

"""Called by long work with (done, total, what)."""

Stage = Callable[[str], AbstractContextManager[Progress | None]]
"""Opens one stage of a long command by its title and gives the progress callback for it, or None."""


DEFAULT_LIBRARY = Path("library.zarr")
DEFAULT_MODEL = Path("model.h5")

PREDICTED = "Predicted at latent"
"""How the descriptions of predicted files begin."""

_FILE_INCIDENCES_DEG = (0.0, 30.0, 60.0, 75.0, 80.0, 85.0)  # where the albedo of a written file is looked at


def no_stage(title: str) -> AbstractContextManager[None]:
    """A stage nobody watches."""
    return nullcontext()


@dataclass(frozen=True)
class Prediction:
    """A predicted material and what is known of it.

    Attributes:
        latent: where it lies, shape (Q,).
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
        cautions: what a user should know before trusting it, in sentences.
        clipped_share: share of the file's values that were negative and became zero.
        seconds: evaluating and writing, without loading the library.
    """

    latent: tuple[float, ...]
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
    cautions: tuple[str, ...]
    clipped_share: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        content = dict(vars(self))
        content |= {"path": str(self.path), "plausibility": vars(self.plausibility)}
        return {"program": f"manifold {__version__}", **content}


def make_corpus(
    folder: Path, *, seed: int = 0, anisotropic: bool = False, rgb: bool = False,
    on_progress: Progress | None = None,
) -> list[Path]:  # fmt: skip
    """Write the built-in synthetic corpus into a folder; see `corpus.write`."""
    return corpus.write(folder, seed=seed, anisotropic=anisotropic, rgb=rgb, on_progress=on_progress)


def import_library(
    library: Path, sources: Iterable[Path], *, replace: bool = False, on_progress: Progress | None = None
) -> ImportResult:
    """Import files and folders into a library; see `importing.import_files`."""
    return import_files(library, sources, replace=replace, on_progress=on_progress)


@dataclass(frozen=True)
class Embedding:
    """A fitted manifold, and what its settings were chosen from.

    Attributes:
        model: saved already.
        candidates: settings that were tried, where any was to be chosen.
    """

    model: Manifold
    candidates: tuple[Candidate, ...]


def embed(
    library: Path,
    model: Path,
    settings: Settings,
    *,
    auto_mapping: bool = False,
    auto_latent_dim: bool = False,
    stage: Stage = no_stage,
) -> Embedding:
    """Fit a manifold to a library and save it; see `selection.choose` for what `auto` means."""
    atomic.require_writable(model)
    opened = Library.open(library)
    candidates: list[Candidate] = []
    if auto_mapping or auto_latent_dim:
        with stage("Reading materials") as step:
            materials = []
            for name in opened.names:
                materials.append(MeasuredBRDF(close_holes(opened.read(name))))
                if step is not None:
                    step(len(materials), len(opened.names), name)
        with stage("Leaving materials out") as step:
            settings, candidates = selection.choose(
                materials, settings, mapping=auto_mapping, latent_dim=auto_latent_dim, on_progress=step
            )
    with stage("Embedding") as step:
        fitted = Manifold.fit(opened, settings, step)
    fitted.save(model)
    return Embedding(fitted, tuple(candidates))


def predict(
    model: Manifold | Path,
    latent: Array | Sequence[float],
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
        latent: Q coordinates.
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
    file = gonio.measure(
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
        cautions=cautions.of_prediction(is_extrapolation, found, chosen.missed)
        + cautions.of_file(found.max_albedo, file_albedo)
        + cautions.of_holes(model.hole_share(x)),
        clipped_share=clipped.clipped_share,
        seconds=seconds,
    )


def _describe(model: Manifold, x: Array, colour: str | None, physical: bool) -> str:
    """What a predicted file says about itself."""
    synthetic = any(model.library.attributes(name).is_synthetic for name in model.names)
    origin = "a synthetic corpus" if synthetic else f"{len(model.names)} measured materials"
    at = ", ".join(f"{v:.4g}" for v in x)
    how = (f", coloured {colour}" if colour else "") + ", projected to be physical" * physical
    return f"{PREDICTED} ({at}){how} from {origin} by manifold {__version__}"


@dataclass(frozen=True)
class Located:
    """Where a file belongs on a manifold.

    Attributes:
        path: the file.
        latent: shape (Q,).
        colours: colour coordinate of every band, of a monochrome manifold.
        relative_error: of the material that the manifold gives back there.
        std: posterior standard deviation there, as a fraction of the prior's.
        nearest: the three nearest materials with their distances.
        cautions: what speaks against it.
    """

    path: Path
    latent: tuple[float, ...]
    colours: tuple[float, ...] | None
    relative_error: float
    std: float
    nearest: tuple[tuple[str, float], ...]
    cautions: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the program's version."""
        return {"program": f"manifold {__version__}", **vars(self), "path": str(self.path)}


def locate(
    model: Path, path: Path, *, library: Path | None = None, on_progress: Progress | None = None
) -> Located:
    """Embed a measured file, its holes closed, in a manifold that has not seen it.

    Raises:
        FileFormatError: it is no RGL file.
        BandMismatchError: its bands are not the library's.
    """
    file = read_bsdf(path)
    holes = find_holes(file)
    brdf = MeasuredBRDF(close_holes(file, holes))
    loaded = Manifold.load(model, library)
    loaded.prepare(on_progress)
    found = loaded.embed(brdf)
    colours = None if found.colours is None else tuple(float(c) for c in found.colours)
    return Located(
        path=path,
        latent=tuple(float(v) for v in found.latent),
        colours=colours,
        relative_error=found.relative_error,
        std=float(loaded.std(found.latent, found.colours)),
        nearest=tuple(loaded.nearest(found.latent, 3)),
        cautions=cautions.of_embedding(found.relative_error) + cautions.of_holes(share_of_holes(file, holes)),
    )


def report(
    model: Path,
    *,
    library: Path | None = None,
    grid: str = "default",
    compare: bool = False,
    all_bands: bool = False,
    picture: Path | None = None,
    on_progress: Progress | None = None,
) -> Report:
    """Evaluate a model and other methods, see `make_report`; with `picture`, also draw the map of its latents."""
    if picture is not None:
        figures.require_writable(picture)
    loaded = Manifold.load(model, library)
    if len(loaded.names) < 3:
        raise UsageError(
            f"{model}: found {len(loaded.names)} materials, expected at least 3 to leave one out; import more"
        )
    made = make_report(loaded, grid, on_progress, compare=compare, all_bands=all_bands)
    if picture is not None:
        figures.save(plot_latents.latent_map(loaded), picture)
    return made
