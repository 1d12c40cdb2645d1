"""The page that `manifold demo` ends in: one HTML file beside its pictures."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

from manifold.experiments.evaluation.report import Report
from manifold.experiments.evaluation.report_text import lead
from manifold.model.diagnostics import Prediction

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
    folder: Path, pictures: Sequence[Path], explorer: Path, predicted: Prediction, report: Report
) -> str:
    """What was done, the numbers that count, pictures, the explorer and the next commands, as HTML.

    Args:
        folder: of the demo; links are relative to it.
        pictures: in the folder.
        explorer: the interactive map, in the folder.
        predicted: the prediction of the demo.
        report: on its model.
    """
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


def _numbers(predicted: Prediction, report: Report) -> list[tuple[str, str]]:
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
