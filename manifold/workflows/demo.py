"""The work behind `manifold demo`: every step on the built-in corpus, into one folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from manifold.brdf.analytic import corpus
from manifold.errors import LibraryError
from manifold.experiments.budget import example_scenes
from manifold.experiments.chart.experiment import make_chart
from manifold.experiments.evaluation.report import Report, make_report
from manifold.experiments.evaluation.report_text import format_report
from manifold.experiments.stability.catalogue import MODES
from manifold.experiments.stability.trials import run_modes, select_modes
from manifold.library.importing import import_files
from manifold.library.location import require_outside_libraries
from manifold.model.diagnostics import Prediction
from manifold.model.settings import Settings
from manifold.plots import figures, plot_chart, plot_latents, plot_stability
from manifold.rendering import backend
from manifold.rendering.render import RenderSettings
from manifold.system import atomic, progress
from manifold.workflows import ball_pictures, budgets, demo_page, fits, pipeline, renders
from manifold.workflows.budgets import BudgetSettings
from manifold.workflows.explore import write_page
from manifold.workflows.fit_pictures import picture_of_fit
from manifold.workflows.fits import FitSettings
from manifold.workflows.pictures import slices, sources
from manifold.workflows.prediction import predict
from manifold.workflows.sources import FileSource, LibrarySource, MaterialSource

START, END = "syn_satin_gold", "syn_metallic_gold"
"""The materials that the demo predicts between, and walks between."""
_BETWEEN = f"{START}:{END}:0.75"

CHARTED = (
    "nearest", "linear", "published", "pca_6_cube-root", "gplvm_2_cube-root", "gplvm_6_cube-root",
    "blend_2", "blend_2_half", "blend_2_angles_2_1", "nonnegative", "fit_gauss-newton",
)  # fmt: skip
"""Settings in the demo's chart; `manifold chart` measures all."""

TRIED = (
    "short_length_scale",
    "few_materials",
    "outside_materials",
    "across_classes",
    "exact_zeros",
    "rough_or_smooth",
)
"""Failure modes that the demo tries; `manifold stability` tries all."""

FIT = "predicted.fit.json"


@dataclass(frozen=True)
class DemoResult:
    """What `run` made.

    Attributes:
        files: what was written, by what it is.
        predicted: the prediction.
        report: the report.
        left_out: what could not be made here.
    """

    files: dict[str, list[Path]]
    predicted: Prediction
    report: Report
    left_out: str | None


def run(folder: Path) -> DemoResult:
    """Files, library, model, a prediction, renders, a fit, the report, and a page (`index.html`) that shows them.

    A folder with an earlier demo is used again: its measured materials, library and fit are kept, all else is
    made anew. Without Mitsuba nothing is rendered or fitted.

    Raises:
        UsageError: the folder lies in a library.
    """
    require_outside_libraries(folder, into=True)
    folder.mkdir(parents=True, exist_ok=True)
    files, library, model = folder / "corpus", folder / "library.zarr", folder / "model.h5"
    with progress.shown("Measuring the synthetic corpus"):
        corpus.write(files, keep=True)
    with progress.shown("Importing it into a library"):
        imported = import_files(library, [files])
        if imported.failed:
            raise LibraryError(f"{next(iter(imported.failed.values()))}; or delete {folder} and start again")
    fitted = pipeline.embed(library, model, Settings())[0]
    with progress.shown("Predicting a material between two"):
        path = folder / "predicted_spec.bsdf"
        predicted = predict(fitted, _BETWEEN, path)
    pictures = [folder / "slices.png", folder / "map.png"]
    golds: list[MaterialSource] = [
        LibrarySource(library, START),
        LibrarySource(library, END),
        FileSource(path),
    ]
    slices(sources(golds), pictures[0])
    has_mitsuba = backend.is_available()
    with progress.shown("Drawing the map"):
        if has_mitsuba and backend.choose().is_llvm:
            ball_pictures.latent_map(model, pictures[1], marked=_BETWEEN)
        else:  # balls would take minutes
            figures.save(plot_latents.latent_map(fitted, marked=fitted.place(_BETWEEN).latent), pictures[1])
    if has_mitsuba:
        pictures += _with_mitsuba(folder, model, path)
    with progress.shown("Charting speed against accuracy"):
        pictures.append(folder / "chart.png")
        opened = fitted.library
        charted = make_chart([opened.read(name) for name in opened.names], CHARTED, library=opened)
        figures.save(plot_chart.chart(charted), pictures[-1])
    with progress.shown("Testing failure modes"):
        pictures.append(folder / "stability.png")
        modes = select_modes(MODES, TRIED)
        figures.save(plot_stability.panels(run_modes(modes), modes), pictures[-1])
    with progress.shown("Evaluating the model"):
        made = make_report(fitted, "default")
    text, document = folder / "report.txt", folder / "report.json"
    atomic.write_text(text, format_report(made))
    atomic.write_text(document, json.dumps(made.to_json(), indent=2, allow_nan=False) + "\n")
    with progress.shown("Writing the page"):
        explorer, index = folder / "explorer.html", folder / "index.html"
        write_page(model, explorer)
        atomic.write_text(index, demo_page.page(folder, pictures, explorer, predicted, made))
    written = {
        "page": [index, explorer],
        "library": [library],
        "model": [model],
        "prediction": [path],
        "fit": [folder / FIT] * has_mitsuba,
        "report": [text, document],
        "pictures": pictures,
    }
    left_out = None if has_mitsuba else "renders, walk, fits and budgets, since Mitsuba is missing"
    return DemoResult(written, predicted, made, left_out)


def _with_mitsuba(folder: Path, model: Path, predicted: Path) -> list[Path]:
    """Renders, the walk, a fit, budgets; the pictures made."""
    pictures = [folder / "predicted.png"]
    with progress.shown("Rendering the prediction"):
        renders.render(FileSource(predicted), pictures[0], RenderSettings())
    if backend.choose().is_llvm:
        with progress.shown("Drawing the walk"):
            pictures.append(folder / "walk.png")
            ends = [LibrarySource(folder / "library.zarr", name) for name in (START, END)]
            ball_pictures.walk(model, ends[0], ends[1], pictures[-1])
    with progress.shown("Fitting game parameters to the prediction"):
        fits.fit_file(predicted, folder / FIT, FitSettings())
        pictures.append(folder / "predicted.fit.png")
        picture_of_fit(folder / FIT, predicted, pictures[-1])
    with progress.shown("Budgeting three scenes"):
        settings = BudgetSettings() if backend.choose().is_llvm else BudgetSettings(size=48, samples=32)
        for name in example_scenes.EXAMPLES:
            pictures.append(folder / f"budget_{name}.png")
            budgets.example(name, settings=settings, output=folder / "budget" / name, picture=pictures[-1])
    return pictures
