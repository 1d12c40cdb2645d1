"""Implements `manifold demo`: completes a measured material from 12 readings, then runs all steps on synthetic data."""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from manifold import __version__
from manifold.analytic import corpus
from manifold.analytic.virtual_instruments import ma_t12_readings
from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.illuminants import Illuminant
from manifold.core import disk, progress, shipped
from manifold.core.errors import LibraryError
from manifold.core.judged_lights import BALL, BALL_COLUMN, LIGHTS
from manifold.core.names import percent
from manifold.core.records import Array
from manifold.estimate.completion import Completion
from manifold.estimate.completions import atoms_of
from manifold.estimate.expected import calibrate
from manifold.estimate.predictions import predict
from manifold.estimate.reports import studio_ball
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource
from manifold.evaluate.report import Report, make_report
from manifold.evaluate.report_text import format_report, lead
from manifold.io_rgl import read_bsdf
from manifold.library.identity import require_outside_libraries
from manifold.library.importing import import_files
from manifold.library.store import Library
from manifold.model.coherence import Pair, typical_pair
from manifold.model.comparison import brdf_errors
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.model.embedding import embed
from manifold.model.manifold import Manifold
from manifold.model.output_file import COMPLETION_OPTIONS, write_output
from manifold.model.places import on_line
from manifold.model.settings import BlendSettings
from manifold.page.explore import write_page
from manifold.pictures import ball_figures, figures, map_figure, maps, renders
from manifold.pictures.maps import slices, sources
from manifold.pictures.slice_figures import ShownBRDF
from manifold.registries import EXAMPLES
from manifold.render import backend
from manifold.render.render import RenderSettings

ILLUMINANTS = ("D65", "F11")
"""Illuminants under which the demo renders its prediction: daylight, and with `--all` a fluorescent lamp."""

ALONE = 0.98
"""Smallest share of two materials in the weights halfway between them for the demo to predict there. A value between
their cube roots then changes by at most about 6 %, and no third material is visible."""

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

_CAPTIONS = (
    "The completed material and the measured one, as balls in the studio",
    "Values of both in the plane of incidence",
)
_NO_MITSUBA = "nothing is rendered, because Mitsuba is missing"
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


@dataclass(frozen=True)
class Made:
    """A result of the demo.

    Attributes:
        what: a sentence that describes the result.
        paths: its files, the most interesting first.
        look: a command to run or a file to open to see it.
        seconds: time since the demo began.
    """

    what: str
    paths: tuple[Path, ...]
    look: str
    seconds: float


@dataclass(frozen=True)
class CompletedMaterial:
    """A measured material of the built-in library, completed from 12 simulated readings with the other materials.

    Attributes:
        true, expected: errors of the completion, CIEDE2000 of the ball.
        left_out: true errors of all N materials when they are completed in this way, shape (N,).
        pictures: pictures of its ball and values beside the measured ones.
    """

    name: str
    true: float
    expected: float
    left_out: Array
    path: Path
    pictures: tuple[Path, ...]

    @property
    def words(self) -> str:
        """A text that describes the completion and its error."""
        return (
            f"{self.name}, a measured material, completed from 12 simulated readings of a multi-angle "
            f"spectrophotometer with the other {len(self.left_out) - 1} materials of the built-in library: off by "
            f"{self.true:.1f} {BALL}, expected {self.expected:.1f}. It is the material of median error: the "
            f"{len(self.left_out)} materials, each left out in this way, are off by {np.median(self.left_out):.1f} in "
            f"the median and {np.quantile(self.left_out, 0.9):.1f} at the 90th percentile."
        )


@dataclass(frozen=True)
class DemoResult:
    """The results of a demo, in the order in which they were made, and omitted ones with the reason."""

    made: tuple[Made, ...]
    completed: CompletedMaterial
    predicted: DiagnosedPrediction
    report: Report
    left_out: str | None

    @property
    def pictures(self) -> list[Path]:
        """The pictures among the results."""
        return _pictures(self.made)


def run(
    folder: Path, *, everything: bool = False, announce: Callable[[Made], object] = lambda made: None
) -> DemoResult:
    """Complete a measured material, then make a corpus, a library, a model, a prediction and a page (`index.html`).

    The prediction has renders and a fit, and the model a report.

    Measured materials, library and fit of an earlier demo in the folder are kept; everything else is made again.
    Nothing is rendered without Mitsuba.

    Args:
        folder: folder for all files; it is created if missing.
        everything: also draw the second light, the fit, the map as balls and a walk, and run a chart, failure modes
            and budgets (minutes).
        announce: called with every result when it exists.
    """
    require_outside_libraries(folder, into=True)
    folder.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    made: list[Made] = []

    def add(what: str, *paths: Path, look: str = "") -> None:
        made.append(Made(what, paths, look or f"open {paths[0]}", time.monotonic() - start))
        announce(made[-1])

    files, library, model = folder / "corpus", folder / "library.zarr", folder / "model.h5"
    has_mitsuba = backend.is_available()
    with progress.shown("Completing a measured material from 12 readings"):
        completed = complete_measured(folder)
    add(completed.words, *completed.pictures, completed.path)
    with progress.shown("Measuring the synthetic corpus"):
        written = corpus.write(files, keep=True)
    add(
        f"{len(written)} synthetic materials, measured by a virtual goniometer",
        files,
        look=f"manifold info {written[0]}",
    )
    with progress.shown("Importing it into a library"):
        imported = import_files(library, [files])
        if imported.failed:
            raise LibraryError(f"{next(iter(imported.failed.values()))}; or delete {folder} and start again")
    add("Library of these materials (a Zarr store)", library, look=f"manifold info {library}")
    embed(library, model, BlendSettings())
    fitted = Manifold.load(model)
    with progress.shown("Evaluating the model"):
        report = make_report(fitted, "default")
    text, document = folder / "report.txt", folder / "report.json"
    disk.write_text(text, format_report(report))
    disk.write_text(document, json.dumps(report.to_json(), indent=2, allow_nan=False) + "\n")
    add(f"Evaluation. {lead(report)}", text, document)
    pair = pair_to_show(fitted, report.pairs)
    ends = [fitted.names[k] for k in (pair.first, pair.second)]
    between = on_line(fitted.X[pair.first], fitted.X[pair.second], 0.5)
    map_file = folder / "map.png"
    figures.save(map_figure.latent_map(fitted, marked=between), map_file)
    add(f"Map of {fitted.settings.latent_dim} dimensions, fitted to the library", map_file, model)
    latent = ",".join(f"{value:.3f}" for value in between)
    path = folder / "predicted_spec.bsdf"
    with progress.shown("Predicting a material between two"):
        predicted = predict(fitted, latent, path)
    add(
        f"Predicted BRDF, never measured, at latent {latent}, halfway between two similar materials, {ends[0]} and "
        f"{ends[1]}",
        path,
        look=f"manifold info {path}",
    )
    drawn: list[MaterialSource] = [*(LibrarySource(library, name) for name in ends), FileSource(path)]
    slices(sources(drawn), folder / "slices.png")
    add(
        "Values of the two materials and of the prediction between them, in the plane of incidence",
        folder / "slices.png",
    )
    if has_mitsuba:
        for name in ILLUMINANTS if everything else ILLUMINANTS[:1]:
            picture = folder / f"predicted_{name}.png"
            with progress.shown(f"Rendering the prediction under {name}"):
                renders.render(FileSource(path), picture, _render_settings(name))
            add(f"The prediction, rendered spectrally under {name}", picture)
    is_fit_drawn = has_mitsuba and everything
    _fit(folder, path, is_fit_drawn)
    add(
        "Parameters of Mitsuba's principled BSDF, fitted to the prediction",
        *([folder / "predicted.fit.png"] if is_fit_drawn else []),
        folder / FIT,
    )
    if everything:
        _make_the_rest(folder, fitted, ends, has_mitsuba, add)
    with progress.shown("Writing the page"):
        write_page(model, folder / "explorer.html")
        add(
            "Interactive map: drag the point to see the material there",
            folder / "explorer.html",
        )
        index = folder / "index.html"
        left_out = None if has_mitsuba else _NO_MITSUBA
        disk.write_text(index, page(folder, made, completed, predicted, report, left_out))
    add("Page with all results and the next commands", index)
    return DemoResult(tuple(made), completed, predicted, report, left_out)


def complete_measured(folder: Path) -> CompletedMaterial:
    """Complete the built-in material with the median error from simulated readings and the other materials; draw it."""
    library = Library(shipped.BUILT_IN)
    atoms = atoms_of(library)
    measured = MeasuredBRDF(library.read(atoms.names[0]))
    left_out = calibrate(atoms, ma_t12_readings(measured, ""), library).errors.ball
    chosen = int(np.argsort(left_out, kind="stable")[len(left_out) // 2])
    name = atoms.names[chosen]
    measured, others = MeasuredBRDF(library.read(name)), atoms.without(chosen)
    made = Completion.of(others, [ma_t12_readings(measured, name)])
    path = folder / f"{name}_completed_rgb.bsdf"
    through = f"through {len(others.names)} materials by manifold {__version__}"
    write_output(
        path, made.brdf, COMPLETION_OPTIONS, description=f"Completed from 12 simulated readings {through}"
    )
    completed = MeasuredBRDF(read_bsdf(path))
    found = CompletedMaterial(
        name, brdf_errors(measured, completed).ball, calibrate(others, made.readings).expected(made).ball, left_out,
        path, (folder / "completed.png", folder / "completed_slices.png"),
    )  # fmt: skip
    balls = [("completed from 12 readings", completed), ("measured", measured)]
    title = f"{name}: off by {found.true:.1f} CIEDE2000 (mean of {LIGHTS}), expected {found.expected:.1f}"
    images = [(label, studio_ball(brdf)) for label, brdf in balls]
    figures.save(ball_figures.balls_beside(title, images), found.pictures[0])
    slices([ShownBRDF(label, brdf) for label, brdf in balls], found.pictures[1])
    return found


def pair_to_show(model: Manifold, pairs: Sequence[Pair]) -> Pair:
    """Return the typical pair among pairs whose midpoint on the map has no third material.

    If there is no such pair, it is the typical pair among all.
    """

    def share(pair: Pair) -> float:
        both = model.names[pair.first], model.names[pair.second]
        middle = on_line(model.X[pair.first], model.X[pair.second], 0.5)
        return sum(weight for name, weight in model.largest_weights(middle, 3) if name in both)

    return typical_pair([pair for pair in pairs if share(pair) >= ALONE] or pairs)


def _make_the_rest(
    folder: Path, fitted: Manifold, between: Sequence[str], has_mitsuba: bool, add: Callable[..., None]
) -> None:
    """Make what `manifold demo --all` adds: balls on the map, a walk, budgets, a chart, failure modes."""
    from manifold.study import chart_figure
    from manifold.study.budget import budgets
    from manifold.study.budget.budgets import BudgetSettings
    from manifold.study.chart import make_chart
    from manifold.study.stability import stability_figure
    from manifold.study.stability.catalogue import MODES
    from manifold.study.stability.trials import run_modes, select_modes

    if has_mitsuba and backend.choose().is_llvm:  # scalar variants take minutes for each ball
        picture = folder / "map_balls.png"
        with progress.shown("Drawing the map"):
            maps.latent_map(folder / "model.h5", picture)
        add(
            "The map as rendered balls; the background is the expected error, hatched where data are missing",
            picture,
        )
        picture = folder / "walk.png"
        with progress.shown("Drawing the walk"):
            ends = [LibrarySource(folder / "library.zarr", name) for name in between]
            maps.walk(folder / "model.h5", ends[0], ends[1], picture)
        add(
            "Walk from one of the two materials to the other, above predictions on the straight line of the map",
            picture,
        )
    if has_mitsuba:
        settings = BudgetSettings() if backend.choose().is_llvm else BudgetSettings(size=48, samples=32)
        for name in EXAMPLES:
            picture = folder / f"budget_{name}.png"
            with progress.shown(f"Budgeting the scene of {name}"):
                budgets.example(name, settings=settings, output=folder / "budget" / name, picture=picture)
            add(f"Cheapest representation that preserves the image of a scene of {name}", picture)
    with progress.shown("Charting speed against accuracy"):
        library = fitted.library
        chart = make_chart([library.read(name) for name in library.names], CHARTED, library=library)
        figures.save(chart_figure.chart(chart), folder / "chart.png")
    add("Speed against accuracy of some methods", folder / "chart.png")
    with progress.shown("Testing failure modes"):
        modes = select_modes(MODES, TRIED)
        figures.save(stability_figure.panels(run_modes(modes), modes), folder / "stability.png")
    add("Failure modes, and whether they are detected", folder / "stability.png")


def _render_settings(illuminant: str) -> RenderSettings:
    return RenderSettings(illuminant=Illuminant.named(illuminant))


def _fit(folder: Path, predicted: Path, is_drawn: bool) -> None:
    from manifold.fit import fits
    from manifold.fit.fits import FitSettings
    from manifold.pictures.fit_comparison import picture_of_fit

    with progress.shown("Fitting principled to the prediction"):
        fits.fit(predicted, folder / FIT, FitSettings())
        if is_drawn:
            picture_of_fit(folder / FIT, predicted, folder / "predicted.fit.png")


def _pictures(made: Sequence[Made]) -> list[Path]:
    return [path for each in made for path in each.paths if path.suffix == ".png"]


def page(
    folder: Path, made: Sequence[Made], completed: CompletedMaterial, predicted: DiagnosedPrediction, report: Report,
    left_out: str | None,
) -> str:  # fmt: skip
    """Return the HTML page of a demo: the completed material, the map, all results, and the next commands."""
    steps = [
        f"{escape(each.what)} ({', '.join(_link(path.name) for path in each.paths)})"
        for each in made
        if each.paths[0].suffix != ".txt"  # the report has a part of its own
    ] + [left_out] * (left_out is not None)
    first = [_figure(path, caption) for path, caption in zip(completed.pictures, _CAPTIONS, strict=True)]
    shown = [
        _figure(path, each.what)
        for each in made
        for path in _pictures([each])
        if path not in completed.pictures
    ]
    numbers = "".join(
        f"<dt>{escape(n)}</dt><dd>{escape(meaning)}</dd>" for n, meaning in _numbers(predicted, report)
    )
    listed = "\n".join(f"<li>{step}</li>" for step in steps)
    return f"""<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>manifold demo</title>
<style>{_STYLE}</style>
<h1>manifold demo</h1>
<h2>A BRDF from 12 readings</h2>
<p>{escape(completed.words)}</p>
{"".join(first)}
<h2>A map of {len(report.names)} materials</h2>
<p>{escape(lead(report))} {_link("report.txt")} has all errors.</p>
<p>Drag the point to see the material predicted there. <a href="explorer.html">Open in its own window</a></p>
<iframe src="explorer.html" title="Interactive map of the materials" loading="lazy"></iframe>
<dl>
{numbers}
</dl>
<h2>Files</h2>
<ol>
{listed}
</ol>
<h2>Pictures</h2>
{"".join(shown)}
<h2>Next steps</h2>
<pre>{escape(_next_commands(folder))}</pre>
</html>
"""


def _numbers(predicted: DiagnosedPrediction, report: Report) -> list[tuple[str, str]]:
    """Return numbers and their meaning."""
    physical = predicted.plausibility
    numbers = [
        (
            f"{len(report.names)} materials",
            f"The library holds them in {report.bands}; the map is fitted to all.",
        )
    ]
    expected = predicted.expected_in_chosen_colour or predicted.expected
    if expected is not None:
        numbers.append((
            f"{float(expected.ball):.1f} {BALL_COLUMN}",
            f"Expected error of the prediction against a material of its colour, averaged over a ball and {LIGHTS}.",
        ))  # fmt: skip
    return [
        *numbers,
        (
            f"{physical.max_albedo:.2f}",
            "Largest directional albedo of the prediction; more than 1 would create energy.",
        ),
        (
            percent(physical.reciprocity_error, 1),
            "Reciprocity error of the prediction: the relative change of its values if light and view are exchanged.",
        ),
    ]


def _next_commands(folder: Path) -> str:
    """Return commands with the path of the `manifold` that made the demo."""
    installed = Path(sys.executable).with_name("manifold")
    command = shlex.quote(str(installed)) if installed.exists() else "manifold"
    where = shlex.quote(str(folder.resolve()))
    return f"""cd {where}
{command} explore                                  # the map, with everything that the commands below do
{command} predict 0.5,0.5 -o mine_spec.bsdf        # another material between measured ones
{command} export predicted_spec.bsdf -o predicted.glb   # into an engine
{command} report                                   # all errors
{command} fetch -o rgl                           # measured materials: 51 files, 400 MB
{command} import rgl --library rgl.zarr            # then embed --library rgl.zarr --output rgl.h5
"""


def _figure(path: Path, caption: str) -> str:
    return (
        f'<figure><a href="{path.name}"><img src="{path.name}" alt="{escape(caption)}" loading="lazy"></a>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _link(name: str) -> str:
    return f'<a href="{escape(name)}">{escape(name)}</a>'
