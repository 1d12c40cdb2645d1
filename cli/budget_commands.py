"""The command budget."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold import progress
from manifold.errors import UsageError

from . import options, terminal
from .application import app
from .outputs import written

if TYPE_CHECKING:
    from manifold.evaluate.budget.budgets import Budget

_NAME = 16  # columns of a material's name in the table; below it stands in full


@app.command(
    "budget",
    short_help="The cheapest representation of a scene's materials that keeps its picture.",
    epilog="Example: manifold budget --example felt, or manifold budget scene.xml --max-delta-e 0.5 -o lean",
)
def budget(
    scene: Annotated[
        Path | None, typer.Argument(help="Mitsuba scene, .xml or .json.", metavar="SCENE")
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            help="Instead of a scene: {manifold.evaluate.budget.example_scenes.EXAMPLES}.", metavar="NAME"
        ),
    ] = None,
    max_delta_e: Annotated[
        float, typer.Option(help="Largest mean CIEDE2000 over the pixels of a material.", metavar="X")
    ] = 1.0,
    max_flip: Annotated[
        float | None, typer.Option(help="Largest mean FLIP over the pixels of a material.", metavar="X")
    ] = None,
    max_bytes: Annotated[
        int | None, typer.Option(help="Largest size of all materials together.", metavar="N")
    ] = None,
    max_ms: Annotated[
        float | None, typer.Option(help="Largest time of a million evaluations of a material.", metavar="X")
    ] = None,
    output: Annotated[
        Path | None,
        options.output_option("Folder for the files and a scene that uses them.", "DIR"),
    ] = None,
    size: Annotated[
        int, typer.Option(help="Pixels of the longer side, in the analysis.", metavar="N", min=16, max=2048)
    ] = 128,
    samples: Annotated[
        int, typer.Option(help="Light paths per pixel, in the analysis.", metavar="N", min=1, max=1 << 16)
    ] = 128,
    seed: Annotated[int, typer.Option(help="Fixes the noise.", metavar="N", min=0)] = 0,
    picture: Annotated[
        Path | None,
        written("--picture", help="Also draw both renders and the cost of every representation."),
    ] = None,
    json: options.JsonOption = None,
) -> None:  # fmt: skip
    """Find the cheapest representation of each measured material that keeps the rendered picture.

    BSDFs of the types measured and manifold are replaced by a parametric fit, by fewer bands or by fewer angles,
    or are kept. A CIEDE2000 of 1 is visible side by side.
    """
    from manifold.evaluate.budget import budgets
    from manifold.evaluate.budget.search import Tolerance

    results = terminal.Results(json)
    if (scene is None) == (example is None):
        found = "neither a scene nor --example" if scene is None else "a scene and --example"
        raise UsageError(f"found {found}; give one of them")
    if output is not None and output.suffix.lower() in (".png", ".xml", ".json") and not output.is_dir():
        raise UsageError(f"{output}: named like a file, expected a folder; --picture FILE draws the renders")
    tolerance = Tolerance(max_delta_e, max_flip, max_bytes, max_ms)
    settings = budgets.BudgetSettings(size, samples, seed)
    with progress.shown("Budget"):
        if scene is not None:
            made = budgets.budget_scene(scene, tolerance, settings, output, picture)
        else:
            made = budgets.example(str(example), tolerance, settings, output, picture)
    _show(results, made)


def _show(results: terminal.Results, made: Budget) -> None:
    columns = ["material", "representation", "bytes", "ms", "pred.", "verified", "FLIP"]
    rows = [
        [
            one.material if len(one.material) <= _NAME else f"{one.material[: _NAME - 1]}~",
            one.candidate.name,
            one.candidate.size,
            f"{one.milliseconds:.0f}" if one.milliseconds >= 10 else f"{one.milliseconds:.1f}",
            f"{one.candidate.predicted:.2f}",
            f"{one.verified.delta_e:.2f}",
            f"{one.verified.flip:.3f}",
        ]
        for one in made.chosen
    ]
    results.table(columns, rows)
    for one in made.chosen:
        results.sentence(
            f"{one.material}: {one.lighting}; {one.reason}; noise {one.noise.rendered:.2f}, subtracted"
        )
    results.text("pred., verified: mean CIEDE2000; ms: of a million evaluations\n")
    results.text(f"{made.size} of {made.full_size} bytes, {_share(made)} of the whole files\n")
    for note in made.notes:
        results.sentence(f"note: {note}")
    if made.output is not None:
        results.text(f"wrote {made.output}\n")
    results.document(made.to_json())


def _share(made: Budget) -> str:
    percent = 100.0 * made.size / made.full_size
    return f"{percent:.0f} %" if percent >= 10.0 else f"{percent:.2g} %"
