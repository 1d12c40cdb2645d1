"""Commands about models: embed, predict and locate; and reconstruct, which needs no model."""

from __future__ import annotations

import math
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from manifold.core import progress
from manifold.core.errors import FileFormatError, ManifoldError, UsageError
from manifold.core.names import percent

from . import options, terminal
from .application import app
from .batch_options import (
    ONE,
    PER_CORE,
    OneWorkerOptions,
    PointsOption,
    SchedulerOption,
    WorkerOptions,
    inputs_of,
    make_many,
)
from .outputs import or_default, written

if TYPE_CHECKING:
    from manifold.estimate.sources import MaterialSource
    from manifold.model.diagnostics import DiagnosedPrediction
    from manifold.model.embedding import Embedding
    from manifold.model.location import Reconstruction
    from manifold.model.settings import GplvmSettings, Settings

AUTO = "auto"
_LEAST_TURN_DEG = 5.0  # smallest angle between orientations that is reported


Kind = Literal["blend", "gplvm"]
MaterialsArgument = Annotated[
    list[str],
    typer.Argument(
        help="A .bsdf file, a material of the library, or a point on the map; or several, folders, or libraries.",
        metavar=options.MATERIAL,
    ),
]
OptionalMaterialsArgument = Annotated[
    list[str] | None,
    typer.Argument(
        help="A .bsdf file, a material of the library, or a point on the map; or several, folders, or libraries.",
        metavar=options.MATERIAL,
        show_default=False,
    ),
]
WithoutOption = Annotated[
    list[str] | None,
    typer.Option(
        "--without", help="Leave out this material of the library; may be repeated.", metavar="NAME"
    ),
]


_PREDICTED, _RECONSTRUCTED = "predicted.bsdf", "reconstructed.bsdf"


@app.command(
    "embed",
    epilog="Example: manifold embed --library library.zarr --model model.h5",
)
def embed(
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    output: Annotated[
        Path,
        written("--model", "-M", "--output", "-o", help="The model to write."),
    ] = options.DEFAULT_MODEL,
    kind: Annotated[
        Kind,
        typer.Option(
            help="blend: non-negative combinations of the surrounding materials. gplvm: a Gaussian process of whole "
            "materials (Hikichi & Iwasaki)."
        ),
    ] = "blend",
    latent_dim: Annotated[
        str,
        typer.Option(
            "--latent-dim",
            "-q",
            help="Dimensions of the manifold; auto chooses by the errors of left-out materials and by detours, which "
            "takes minutes.",
            metavar="Q|auto",
        ),
    ] = "2",
    mapping: Annotated[
        str | None,
        typer.Option(
            help="For --kind gplvm: mapping of BRDF values, {manifold.registries.MAPPINGS}; or auto. "
            "[default: {manifold.core.defaults.DEFAULT_MAPPING}]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None,
    optimizer: Annotated[
        str | None,
        typer.Option(
            help="For --kind gplvm: optimiser of the latents, started from principal components: "
            "{manifold.registries.OPTIMIZERS}. dls: direct local search without gradients (Hikichi & Iwasaki, section "
            "3.4); l-bfgs: quasi-Newton. [default: {manifold.core.defaults.DEFAULT_OPTIMIZER}]",
            metavar="NAME",
        ),
    ] = None,
    mu: Annotated[
        float | None,
        typer.Option(
            help="For --kind gplvm: height of the kernel's delta term (nugget), from 1e-10 to 1e6. "
            "[default: {manifold.core.defaults.DEFAULT_MU}]",
            metavar="MU",
        ),
    ] = None,
    length_scale: Annotated[
        float | None,
        typer.Option(
            help="Length scale of the kernel, or of the weights of blends. "
            "[default: {manifold.core.defaults.DEFAULT_LENGTH_SCALE:g}]",
            metavar="L",
        ),
    ] = None,
    prior: Annotated[
        float | None,
        typer.Option(
            help="For --kind gplvm: weight of the Gaussian prior on the latents, per output. "
            "[default: {manifold.core.defaults.DEFAULT_PRIOR:g}]",
            metavar="WEIGHT",
            show_default=False,
        ),
    ] = None,
    grid: Annotated[
        str | None,
        typer.Option(
            help="For --kind gplvm: direction pairs, {manifold.registries.NAMED_GRIDS}. "
            "[default: {manifold.core.defaults.DEFAULT_GRID}]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None,
    kernel: Annotated[
        str | None,
        typer.Option(
            help="For --kind gplvm: kernel, {manifold.registries.KERNELS}; se is squared exponential, as published. "
            "[default: {manifold.core.defaults.DEFAULT_KERNEL}]",
            metavar="NAME",
        ),
    ] = None,
    landmarks: Annotated[
        int | None,
        typer.Option(
            help="For --kind blend: number of landmarks, materials that are laid out first; the others are placed "
            "among them. [default: all of up to "
            "{manifold.core.defaults.MOST_LAID_OUT} materials, else {manifold.core.defaults.LANDMARKS}]",
            metavar="M",
            min=3,
        ),
    ] = None,
    as_published: Annotated[
        bool,
        typer.Option(
            "--as-published",
            help="Use the method exactly as published (Hikichi & Iwasaki): raw values without weights at 90 x 90 x 180 "
            "direction pairs, fixed output variance 1, direct local search from the principal components, and two "
            "dimensions.",
        ),
    ] = False,
    without: WithoutOption = None,
    scheduler: SchedulerOption = None,
    json: options.JsonOption = None,
) -> None:
    """Embed the materials of a library into a low-dimensional manifold.

    Runs in this process on all cores, or with --scheduler as one task on one worker.
    """
    from manifold.core.judged_lights import BALL_COLUMN
    from manifold.evaluate.selection import PAYS, choose
    from manifold.model.embedding import embed
    from manifold.model.settings import GplvmSettings

    results = terminal.Results(json)
    given = {
        "latent_dim": None if latent_dim == AUTO else parse_latent_dim(latent_dim),
        "length_scale": length_scale,
        "mapping": mapping,
        "optimizer": optimizer,
        "mu": mu,
        "prior": prior,
        "kernel": kernel,
        "grid": grid,
        "landmarks": landmarks,
    }
    chosen = {name: value for name, value in given.items() if value is not None}
    settings = _published_settings(latent_dim, chosen) if as_published else _settings(kind, chosen)
    chooses_mapping, chooses_latent_dim = mapping == AUTO, latent_dim == AUTO
    with OneWorkerOptions(None, scheduler).executor() as executor:
        fitted, candidates = embed(
            library, output, settings, without=without or (),
            choose=partial(choose, mapping=chooses_mapping, latent_dim=chooses_latent_dim)
            if chooses_mapping or chooses_latent_dim else None, workers=executor,
        )  # fmt: skip
    settings = fitted.settings
    if candidates:
        results.text(
            "Errors of left-out materials, median / 90th percentile. The choice has the lowest 'error', a mean; more\n"
            f"dimensions must lower 'error' times 'detour', a mean, by {percent(PAYS)}:\n"
        )
        results.table(
            ("mapping", "dimensions", "error", "detour", "linear", "cube root", BALL_COLUMN, "seconds", "chosen"),
            [
                (
                    c.mapping, c.latent_dim, f"{c.error:.3f}", f"{c.detour:.2f}",
                    f"{median.linear:.3f} / {p90.linear:.3f}",
                    f"{median.cube_root:.3f} / {p90.cube_root:.3f}", f"{median.ball:.1f} / {p90.ball:.1f}",
                    f"{c.seconds:.1f}", "*" * c.is_chosen,
                )
                for c in candidates
                for median, p90 in [(c.median, c.p90)]
            ],
        )  # fmt: skip
    results.rows(
        f"Model {output}",
        {
            "materials": fitted.space.materials_in_words,
            "kind": settings.kind + ", as published" * as_published,
            "latent dimensions": settings.latent_dim,
            "mapping": settings.mapping,
            **(_of_process(fitted, settings) if isinstance(settings, GplvmSettings) else {}),
            **_of_errors(fitted),
            **_notes_of_turns(*fitted.materials.farthest_turned),
        },
    )
    results.document(
        {
            "model": str(output),
            "library": library,
            "settings": settings.to_json(),
            "statistics": fitted.statistics,
            "candidates": [c.to_json() for c in candidates],
            "latents": {n: x.tolist() for n, x in zip(fitted.names, fitted.X, strict=True)},
        },
    )


def _settings(kind: str, chosen: dict[str, Any]) -> Settings:
    """Return the settings of a kind by the chosen options; one of the other kind raises UsageError."""
    from manifold.model.settings import KINDS

    names = {own: {each.name for each in fields(settings)} for own, settings in KINDS.items()}
    for name, value in chosen.items():
        if name not in names[kind]:
            (other,) = (own for own in KINDS if name in names[own])
            option = f"--{name.replace('_', '-')} {value}"
            raise UsageError(
                f"found {option}, which works only with --kind {other}; leave it out, or choose that kind"
            )
    return KINDS[kind](**{name: value for name, value in chosen.items() if value != AUTO})


def _published_settings(latent_dim: str, chosen: dict[str, Any]) -> Settings:
    """Return the settings of Hikichi & Iwasaki, which no option changes."""
    from manifold.model.settings import GplvmSettings

    settings = GplvmSettings.published()
    if latent_dim != str(settings.latent_dim) or len(chosen) > 1:
        raise UsageError(
            "found --as-published and another setting of the fit, expected none: it fixes them all"
        )
    return settings


def _of_process(fitted: Embedding, settings: GplvmSettings) -> dict[str, str]:
    """Return rows on the fit of a GPLVM."""
    end, start = (fitted.statistics[name] for name in ("objective", "objective_start"))
    return {
        "kernel": settings.kernel,
        "objective": f"{end:.6g}, from {start:.6g} at the principal components",
        "condition of K": f"{fitted.space.gp.condition:.3g}",
    }


def _of_errors(fitted: Embedding) -> dict[str, str]:
    """Return rows on left-out materials, and on points between materials."""
    import numpy as np

    from manifold.core.judged_lights import BALL

    rows = {}
    if fitted.left_out is not None:
        ball = fitted.left_out.errors.ball
        rows["left-out error"] = (
            f"{np.median(ball):.1f}, 90th percentile {np.quantile(ball, 0.9):.1f} {BALL}; latents kept (optimistic)"
        )
    if fitted.coherence is not None:
        rows["detour"], rows["neighbours kept"] = fitted.coherence.words
        if fitted.coherence.warning:
            rows["diagnostics"] = fitted.coherence.warning
    return rows


def _notes_of_turns(first: str, second: str, angle_rad: float) -> dict[str, str]:
    """Return a row on anisotropic samples that lie turned against each other."""
    degrees = math.degrees(angle_rad)
    if degrees < _LEAST_TURN_DEG:
        return {}
    turned = f"{first} and {second} are turned by {degrees:.0f} degrees relative to each other"
    return {"orientations": f"{turned}; manifold import --replace --rotation auto aligns anisotropic samples"}


def parse_latent_dim(text: str) -> int:
    """Parse the value of --latent-dim, a whole number of at least 1; `auto` is handled before."""
    if not (text.isascii() and text.isdigit() and int(text) >= 1):
        raise UsageError(f"--latent-dim '{text}': expected a whole number of at least 1, or auto")
    return int(text)


@app.command(
    "predict",
    epilog="Example: manifold predict -0.3,1.2 -o between_spec.bsdf",
)
def predict(
    place: Annotated[
        str | None,
        typer.Argument(
            help="Latent coordinates separated by commas, without spaces; FROM:TO:T, a step between two materials (see "
            "`manifold walk`), T from 0 to 1; or a material of the library or a file.",
            metavar="X,Y|FROM:TO:T|NAME|FILE",
            show_default=False,
        ),
    ] = None,
    latent: Annotated[str | None, typer.Option("--latent", hidden=True)] = None,
    points: PointsOption = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    colour: options.ColourOptions = options.OWN_COLOUR,
    asked: options.AttributeOptions = options.NO_ATTRIBUTES,
    physical: options.PhysicalOption = False,
    output: Annotated[
        Path | None,
        options.output_option(
            f"The .bsdf file to write, or the folder. [default: {_PREDICTED}, or predictions]"
        ),
    ] = None,
    resolution: options.ResolutionOption = 32,
    incidences: options.IncidencesOption = 8,
    workers: OneWorkerOptions = ONE,
    json: options.JsonOption = None,
) -> None:
    """Predict the material at a point of the map, or edit a file, and write a .bsdf that Mitsuba opens.

    The colour is blended from the surrounding materials, unless --like, --reflectance or --srgb sets another.
    --lightness, --chroma and --hue change it; --gloss changes only the coat, not the layer below. If a file or a step
    of a walk is given, these options edit its values; `manifold locate` finds the point of a file on the map.
    `--latent X,Y` is equivalent to the argument X,Y.
    """
    from manifold.estimate import predictions
    from manifold.estimate.attributes import Attributes
    from manifold.model.output_file import OutputOptions

    results = terminal.Results(json)
    attributes = Attributes.parse(vars(asked))
    written = OutputOptions(physical, terminal.is_strict(), resolution, incidences)
    if None not in (place, latent):
        raise UsageError(
            f"found two points, {place} and --latent {latent}, expected one; coordinates have commas and no "
            "blanks, such as 0.3,1.2"
        )
    latent = latent if place is None else place.strip()
    if points is not None:
        if latent is not None or colour != options.OWN_COLOUR:
            raise UsageError("found --from and a latent or colour; write these into columns of the table")
        if attributes is not None:
            raise UsageError(
                "found --from and --gloss, --lightness, --chroma or --hue, which work only with one point; leave them "
                "out, or predict each point with a command of its own"
            )
        from manifold.estimate.inputs import read_points
        from manifold.many import commands as many

        rows, failed = read_points(points, model, library)
        command = many.predictions_of(model, library=library, options=written)
        try:
            make_many(results, command, rows, output, workers.executor(), failed=failed)
        except FileFormatError as error:
            raise FileFormatError(f"{points}: {error}") from error
        return
    if latent is None:
        raise UsageError(
            "no point is given; give one, such as -0.3,1.2 or a material, or --from with a table of them; `manifold "
            "complete --lab L,a,b --gloss 60=UNITS` makes a material from only a colour and gloss"
        )
    with progress.shown("Reading materials"):
        made = predictions.predict(
            model,
            latent if place is None else options.material_source(latent, model, library),
            or_default(output, _PREDICTED),
            library=library,
            colour=colour.choice(),
            attributes=attributes,
            options=written,
        )
    show_prediction(results, made)
    results.document(made)


def show_prediction(results: terminal.Results, prediction: DiagnosedPrediction) -> None:
    """Print the results of a prediction, and the next command."""
    assert prediction.path is not None
    next_command = (
        "manifold explore" if prediction.is_extrapolation else terminal.export_command(prediction.path)
    )
    rows = prediction.summary | {"next": next_command} | terminal.notes(prediction.diagnostics)
    results.rows(f"Predicted {prediction.path}", rows)


@app.command(
    "locate",
    epilog="Example: manifold locate my_paint_spec.bsdf",
)
def locate(
    materials: OptionalMaterialsArgument = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    output: Annotated[
        Path | None,
        options.output_option(
            "Also write the reconstruction: the prediction at the latent, in the colours of the file. For "
            "several materials, the folder. [default for several: locations]"
        ),
    ] = None,
    physical: options.PhysicalOption = False,
    workers: WorkerOptions = PER_CORE,
    json: options.JsonOption = None,
) -> None:
    """Find the point of a measured material on the map.

    With --json, the colours found are also written. The predictions of several materials are written into a folder,
    with a table and a picture of all balls.
    """
    from manifold.estimate import descriptions
    from manifold.model.diagnostics import in_words
    from manifold.model.output_file import OutputOptions

    results = terminal.Results(json)
    if not materials:
        raise UsageError(
            "no material is given; give a file, a material of the library, or a point on the map"
        )
    written = OutputOptions(physical, terminal.is_strict())
    sources = options.several_materials(materials, model, library)
    if (several := inputs_of(sources, output)) is not None:
        from manifold.many import commands as many

        command = many.locations(model, library=library, options=written)
        make_many(results, command, several, output, workers.executor())
        return
    source = sources[0]
    with progress.shown("Reading materials"):
        found = descriptions.locate(model, source, output, library=library, options=written)
    rows: dict[str, object] = {
        "latent": ",".join(found.coordinates),
        "nearest": [f"{name} ({distance:.2f})" for name, distance in found.nearest],
        "expected error there": in_words(found.expected, found.materials),
    }
    _show_reconstruction(results, f"Located {source}", rows, found, source, output)


@app.command(
    "reconstruct",
    epilog="Example: manifold reconstruct my_paint_spec.bsdf -o nearest_spec.bsdf",
)
def reconstruct(
    materials: MaterialsArgument,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    without: WithoutOption = None,
    numbers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Describe the material by at most this many numbers, such as 12. [default: as many as needed]",
            metavar="N",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        options.output_option(
            f"The file to write, or the folder. [default: {_RECONSTRUCTED}, or reconstructions]"
        ),
    ] = None,
    physical: options.PhysicalOption = False,
    workers: WorkerOptions = PER_CORE,
    json: options.JsonOption = None,
) -> None:
    """Reconstruct a measured material from a library, by non-negative least squares in every band.

    This is the most accurate method of this program for a measured file: a non-negative combination of single bands of
    all materials and of analytic lobes. It needs no map and gives no point on one. Several materials are written into a
    folder, with a table and a picture of all balls.
    """
    from manifold.estimate import descriptions
    from manifold.model.output_file import OutputOptions

    results = terminal.Results(json)
    written = OutputOptions(physical, terminal.is_strict())
    sources = options.several_materials(materials, model, library)
    if (several := inputs_of(sources, output)) is not None:
        from manifold.many import commands as many

        command = many.reconstructions_of(
            library, without=tuple(without or ()), numbers=numbers, options=written
        )
        make_many(results, command, several, output, workers.executor())
        return
    source, target = sources[0], or_default(output, _RECONSTRUCTED)
    with progress.shown("Reading materials"):
        made = descriptions.reconstruct(
            library, source, target, without=without or (), numbers=numbers,
            options=written,
        )  # fmt: skip
    rows: dict[str, object] = {
        "combination of": f"{made.materials} materials, and analytic lobes",
        "largest shares": [f"{name} ({share:.2f})" for name, share in made.parts],
    }
    _show_reconstruction(results, f"Reconstructed {source}", rows, made, source, target)


def _show_reconstruction(
    results: terminal.Results,
    title: str,
    rows: dict[str, object],
    reconstruction: Reconstruction,
    source: MaterialSource,
    output: Path | None,
) -> None:
    """Print the result, even if its file was refused; then print the reason."""
    written = {} if output is None or reconstruction.refusal is not None else {"written to": output}
    results.rows(title, rows | written | reconstruction.rows)
    path = None if not written else str(output)
    results.document({"source": str(source), "path": path} | reconstruction.to_json())
    if reconstruction.refusal is not None:
        raise ManifoldError(reconstruction.refusal)
