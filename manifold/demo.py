"""The work behind `manifold demo`: every step on the built-in corpus, into one folder, and the page that it ends in."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from manifold import disk, progress
from manifold.analytic import corpus
from manifold.errors import LibraryError
from manifold.estimate.predictions import predict
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource
from manifold.evaluate import chart_figure
from manifold.evaluate.budget import budgets, example_scenes
from manifold.evaluate.budget.budgets import BudgetSettings
from manifold.evaluate.chart import make_chart
from manifold.evaluate.report import Report, make_report
from manifold.evaluate.report_text import format_report, lead
from manifold.evaluate.selection import embed
from manifold.evaluate.stability import stability_figure
from manifold.evaluate.stability.catalogue import MODES
from manifold.evaluate.stability.trials import run_modes, select_modes
from manifold.fit import fits
from manifold.fit.comparison import picture_of_fit
from manifold.fit.fits import FitSettings
from manifold.library.identity import require_outside_libraries
from manifold.library.importing import import_files
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.model.settings import Settings
from manifold.page.explore import write_page
from manifold.pictures import maps, renders
from manifold.pictures.maps import slices, sources
from manifold.plots import figures, map_figure
from manifold.render import backend
from manifold.render.render import RenderSettings

_CAPTIONS = {
    "map.png": "The map: similar materials are close together; the background is the expected error of a prediction "
    "there, hatched where the data do not support it.",
    "predicted.png": "The predicted material, which nobody measured, rendered spectrally.",
    "walk.png": "From one gold to the other. Top: the walk, in steps that look equally large. Bottom: the "
    "predictions on the straight line between their latents.",
    "slices.png": "Values of the two measured golds and of the prediction, in the plane of incidence.",
    "predicted.fit.png": "The prediction beside the parameters of a game engine's model that were fitted to it.",
    "budget_felt.png": "A scene of felt: the cheapest representation that preserves the image.",
    "budget_paint.png": "The same of a painted surface.",
    "budget_chrome.png": "The same of chrome.",
    "chart.png": "Speed against accuracy of a selection of methods; below and left is better.",
    "stability.png": "Where methods fail, and whether they say so; above the line the error is too large.",
}
_STYLE = """
:root { color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif; }
body { max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
figure { margin: 2rem 0; }
img { max-width: 100%; height: auto; background: white; }
figcaption { font-size: .9rem; opacity: .8; }
iframe { width: 100%; height: 46rem; border: 1px solid gray; }
dt { font-weight: bold; font-variant-numeric: tabular-nums; }
pre { overflow-x: auto; padding: .8rem; border: 1px solid gray; }
"""


def page(
    folder: Path, pictures: Sequence[Path], explorer: Path, predicted: DiagnosedPrediction, report: Report
) -> str:
    """What was done, the numbers that count, pictures, the explorer and the next commands, as HTML beside them."""
    names = {path.name for path in pictures}
    steps = [
        f"{len(report.names)} synthetic materials were measured by a virtual goniometer, {report.bands} ("
        f"{_link('corpus')}).",
        f"They were imported into a library ({_link('library.zarr')}), which xarray can open.",
        f"A map of {report.settings['latent_dim']} dimensions was fitted to them ({_link('model.h5')}).",
        f"A material between two golds was predicted ({_link('predicted_spec.bsdf')}); Mitsuba's "
        "<code>measured</code> plugin reads it.",
        "The map was drawn, and made a page to explore.",
        "The values of measured and predicted materials were drawn.",
        *(
            [
                "The prediction was rendered, and the path between the two golds.",
                f"A game engine's parameters were fitted to it ({_link('predicted.fit.json')}).",
                f"Three scenes were given the cheapest materials that preserve their images ({_link('budget')}).",
            ]
            if "predicted.png" in names
            else ["Nothing was rendered or fitted, since Mitsuba is missing."]
        ),
        f"Methods were compared, made to fail, and the model was evaluated ({_link('report.txt')}).",
    ]
    figures = [
        f'<figure><a href="{name}"><img src="{name}" alt="{escape(caption)}" loading="lazy"></a>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for name, caption in _CAPTIONS.items()
        if name in names
    ]
    numbers = [
        f"<dt>{escape(n)}</dt><dd>{escape(meaning)}</dd>" for n, meaning in _numbers(predicted, report)
    ]
    listed = "\n".join(f"<li>{step}</li>" for step in steps)
    return f"""<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>manifold demo</title>
<style>{_STYLE}</style>
<h1>manifold demo</h1>
<h2>What was done</h2>
<ol>
{listed}
</ol>
<h2>The numbers that count</h2>
<p>{escape(lead(report))}</p>
<dl>
{"".join(numbers)}
</dl>
<h2>Explore the map</h2>
<p>Drag the point: the ball is the material predicted there. <a href="{explorer.name}">In a window of its own</a></p>
<iframe src="{explorer.name}" title="Interactive map of the materials" loading="lazy"></iframe>
<h2>Pictures</h2>
{"".join(figures)}
<h2>What to do next</h2>
<pre>{escape(_next_commands(folder))}</pre>
</html>
"""


def _numbers(predicted: DiagnosedPrediction, report: Report) -> list[tuple[str, str]]:
    """Numbers and what they mean."""
    physical = predicted.plausibility
    found = [
        (
            f"{len(report.names)} materials",
            f"The library holds them in {report.bands}, and the map was fitted to all.",
        ),
        (f"{physical.max_albedo:.2f}", "The largest albedo of the prediction: it must not exceed 1."),
        (
            f"{physical.reciprocity_error:.1%}",
            "Reciprocity error of the prediction: how much values change where light and view are exchanged.",
        ),
    ]
    if predicted.expected is not None:
        expected = f"{float(predicted.expected.ball):.1f} CIEDE2000"
        found.insert(
            1, (expected, "What the model expects the error of its prediction to be, on a rendered ball.")
        )
    return found


def _next_commands(folder: Path) -> str:
    """Commands with the path of the `manifold` that made the demo."""
    installed = Path(sys.executable).with_name("manifold")
    command = shlex.quote(str(installed)) if installed.exists() else "manifold"
    where = shlex.quote(str(folder.resolve()))
    return f"""cd {where}
{command} explore                                  # the map, with all that the commands below do
{command} predict --latent 0.5,0.5 -o mine_spec.bsdf    # a material that nobody measured
{command} export predicted_spec.bsdf -o predicted.glb   # into an engine
{command} report                                   # all errors
{command} fetch --to rgl                           # measured materials: 51 files, 400 MB
{command} import rgl --library rgl.zarr            # then embed --library rgl.zarr --output rgl.h5
"""


def _link(name: str) -> str:
    return f'<a href="{name}">{name}</a>'


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
    """What `run` made: files by what they are, and what was left out, as it could not be made here."""

    files: dict[str, list[Path]]
    predicted: DiagnosedPrediction
    report: Report
    left_out: str | None


def run(folder: Path) -> DemoResult:
    """Files, library, model, a prediction, renders, a fit, the report, and a page (`index.html`) that shows them.

    A folder with an earlier demo is used again: its measured materials, library and fit are kept, all else is
    made anew. Without Mitsuba nothing is rendered or fitted.
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
    fitted = embed(library, model, Settings())[0]
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
            maps.latent_map(model, pictures[1], marked=_BETWEEN)
        else:  # balls would take minutes
            figures.save(map_figure.latent_map(fitted, marked=fitted.place(_BETWEEN).latent), pictures[1])
    if has_mitsuba:
        pictures += _with_mitsuba(folder, model, path)
    with progress.shown("Charting speed against accuracy"):
        pictures.append(folder / "chart.png")
        opened = fitted.library
        charted = make_chart([opened.read(name) for name in opened.names], CHARTED, library=opened)
        figures.save(chart_figure.chart(charted), pictures[-1])
    with progress.shown("Testing failure modes"):
        pictures.append(folder / "stability.png")
        modes = select_modes(MODES, TRIED)
        figures.save(stability_figure.panels(run_modes(modes), modes), pictures[-1])
    with progress.shown("Evaluating the model"):
        made = make_report(fitted, "default")
    text, document = folder / "report.txt", folder / "report.json"
    disk.write_text(text, format_report(made))
    disk.write_text(document, json.dumps(made.to_json(), indent=2, allow_nan=False) + "\n")
    with progress.shown("Writing the page"):
        explorer, index = folder / "explorer.html", folder / "index.html"
        write_page(model, explorer)
        disk.write_text(index, page(folder, pictures, explorer, predicted, made))
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
            maps.walk(model, ends[0], ends[1], pictures[-1])
    with progress.shown("Fitting game parameters to the prediction"):
        fits.fit(predicted, folder / FIT, FitSettings())
        pictures.append(folder / "predicted.fit.png")
        picture_of_fit(folder / FIT, predicted, pictures[-1])
    with progress.shown("Budgeting three scenes"):
        settings = BudgetSettings() if backend.choose().is_llvm else BudgetSettings(size=48, samples=32)
        for name in example_scenes.EXAMPLES:
            pictures.append(folder / f"budget_{name}.png")
            budgets.example(name, settings=settings, output=folder / "budget" / name, picture=pictures[-1])
    return pictures
