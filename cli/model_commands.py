"""Commands about models: embed, predict, report, demo."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold.errors import UsageError

from . import terminal
from .library_commands import DEFAULT_LIBRARY, JsonOption, LibraryOption, MovedLibraryOption

if TYPE_CHECKING:
    from manifold.workflows import Prediction

ModelOption = Annotated[Path, typer.Option("--model", "-M", help="The model.", metavar="FILE")]

DEFAULT_MODEL = Path("model.h5")


class Optimizer(StrEnum):
    """Choices of --optimizer."""

    dls = "dls"
    lbfgs = "l-bfgs"


class Grid(StrEnum):
    """Choices of --grid."""

    default = "default"
    seed = "seed"


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(
        "embed",
        short_help="Fit a manifold to a library.",
        epilog="Example: manifold embed --latent-dim 2 --mapping cube-root",
    )(embed)
    app.command(
        "predict",
        short_help="Write the material at a latent coordinate.",
        epilog="Example: manifold predict --latent -0.3,1.2 -o between_spec.bsdf",
    )(predict)
    app.command(
        "report",
        short_help="Evaluate a model.",
        epilog="Example: manifold report --json report.json --picture map.png",
    )(report)
    app.command(
        "demo", short_help="Run everything on the built-in corpus.", epilog="Example: manifold demo demo"
    )(demo)


def embed(
    library: LibraryOption = DEFAULT_LIBRARY,
    model: ModelOption = DEFAULT_MODEL,
    latent_dim: Annotated[
        int, typer.Option("--latent-dim", "-q", help="Dimensions of the manifold.", metavar="Q", min=1)
    ] = 2,
    mapping: Annotated[
        str,
        typer.Option(
            help="How values are compressed: identity, cube-root, log or log-relative.", metavar="NAME"
        ),
    ] = "cube-root",
    optimizer: Annotated[
        Optimizer, typer.Option(help="Direct local search, or L-BFGS with gradients.")
    ] = Optimizer.dls,
    mu: Annotated[
        float,
        typer.Option(help="Noise filter: height of the kernel's delta, from 1e-10.", metavar="MU"),
    ] = 1e-4,
    json: JsonOption = None,
) -> None:
    """Embed the materials of a library into a low-dimensional manifold."""
    from manifold import workflows
    from manifold.model import Settings

    results = terminal.Results(json)
    settings = Settings(latent_dim=latent_dim, mapping=mapping, optimizer=optimizer.value, mu=mu)
    with terminal.progress("Embedding") as step:
        fitted = workflows.embed(library, model, settings, step)
    results.rows(
        f"Model {model}",
        {
            "materials": len(fitted.names),
            "latent dimensions": latent_dim,
            "mapping": mapping,
            "objective": f"{fitted.statistics['objective']:.6g}, from "
            f"{fitted.statistics['objective_start']:.6g} at the principal components",
            "condition of K": f"{fitted.gp.condition:.3g}",
        },
    )
    results.document(
        {
            "model": str(model),
            "library": str(library),
            "settings": dict(vars(settings)),
            "statistics": fitted.statistics,
            "latents": {n: x.tolist() for n, x in zip(fitted.names, fitted.X, strict=True)},
        },
    )


def predict(
    latent: Annotated[
        str,
        typer.Option(help="Where on the map: numbers with commas between, no spaces.", metavar="X,Y"),
    ],
    model: ModelOption = DEFAULT_MODEL,
    library: MovedLibraryOption = None,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The .bsdf file to write.", metavar="FILE")
    ] = Path("predicted.bsdf"),
    resolution: Annotated[
        int, typer.Option(help="Outgoing directions: a grid of N x N.", metavar="N", min=4, max=512)
    ] = 32,
    n_theta_i: Annotated[
        int,
        typer.Option(
            "--incidences", help="Incident elevations from 0 to 90 degrees.", metavar="N", min=2, max=128
        ),
    ] = 8,
    json: JsonOption = None,
) -> None:
    """Predict the material at a latent coordinate and write it as a .bsdf that Mitsuba opens."""
    from manifold import workflows

    results = terminal.Results(json)
    coordinates = parse_latent(latent)
    with terminal.progress("Reading materials") as step:
        made = workflows.predict(
            model,
            coordinates,
            output,
            library=library,
            resolution=resolution,
            n_theta_i=n_theta_i,
            on_progress=step,
        )
    show_prediction(results, made)
    results.document(made.to_json())


def show_prediction(results: terminal.Results, made: Prediction) -> None:
    """Print what is known of a prediction."""
    physical = made.plausibility
    sure = "extrapolated, the data say little here" if made.is_extrapolation else "0 is sure, 1 knows nothing"
    results.rows(
        f"Predicted {made.path}",
        {
            "latent": [f"{v:.4g}" for v in made.latent],
            "uncertainty": f"{made.std:.3f} of the prior's ({sure})",
            "nearest": [f"{name} ({distance:.2f})" for name, distance in made.nearest],
            "largest weights": [f"{name} ({weight:+.2f})" for name, weight in made.weights],
            "negative values": f"{physical.negative_share:.2%}"
            + ", zero in the file" * (made.clipped_share > 0),
            "reciprocity error": f"{physical.reciprocity_error:.2%}",
            "largest albedo": f"{physical.max_albedo:.3f}"
            + ", more than physics allows" * (physical.max_albedo > 1),
            "time": f"{made.seconds:.2f} s after loading",
        },
    )


def parse_latent(text: str) -> list[float]:
    """Numbers separated by commas.

    Raises:
        UsageError: one of them is no finite number.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(f"--latent '{text}': expected numbers separated by commas, like -0.3,1.2") from None
    if not all(map(math.isfinite, values)):
        raise UsageError(f"--latent '{text}': expected finite numbers, like -0.3,1.2")
    return values


def report(
    model: ModelOption = DEFAULT_MODEL,
    library: MovedLibraryOption = None,
    grid: Annotated[
        Grid, typer.Option(help="12,420 direction pairs, or the 1,458,000 of the seed's eq. 22 (minutes).")
    ] = Grid.default,
    json: JsonOption = None,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare", help="Also leave materials out of ten models and baselines (minutes for 195 bands)."
        ),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Also draw the map of the latents.", metavar="FILE.png")
    ] = None,
) -> None:
    """Evaluate a model: reconstruction, leave-one-out against baselines, plausibility, times."""
    from manifold import workflows
    from manifold.report_text import format_comparison, format_report

    results = terminal.Results(json)
    with terminal.progress("Evaluating") as step:
        made = workflows.report(model, library=library, grid=grid.value, picture=picture, on_progress=step)
    results.text(format_report(made))
    document = made.to_json()
    if compare:
        with terminal.progress("Leaving out") as step:
            compared = workflows.compare(model, library=library, on_progress=step)
        results.text("\n" + format_comparison(compared))
        document["comparison"] = [vars(result) for result in compared]
    results.document(document)


def demo(
    folder: Annotated[
        Path, typer.Argument(help="Where to put everything; made if missing.", metavar="FOLDER")
    ] = Path("demo"),
) -> None:
    """Run everything on the built-in synthetic corpus: files, library, model, prediction, report, picture."""
    from manifold import workflows
    from manifold.report_text import format_report

    results = terminal.Results()
    result = workflows.demo(folder, terminal.progress)
    show_prediction(results, result.predicted)
    results.text(f"\n{format_report(result.report)}\n")
    results.rows(
        f"Written to {folder}",
        {
            "library": result.library.name,
            "model": result.model.name,
            "prediction": result.predicted.path.name,
            "report": f"{result.report_text.name}, {result.report_json.name}",
            "map of the latents": result.picture.name,
        },
    )
