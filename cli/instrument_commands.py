"""Commands about instruments' files: convert."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manifold.core import progress
from manifold.core.errors import UsageError

from . import options, terminal
from .application import app
from .batch_options import PER_CORE, WorkerOptions, inputs_of, is_many, make_many

_FORMAT = "rgl"  # of conversions into a folder


@app.command(
    "convert",
    epilog="Example: manifold convert satin_rgb.bsdf -o satin.binary",
)
def convert(
    inputs: Annotated[
        list[str],
        typer.Argument(
            help="A file; the files of one sample, one per incidence; a material of the library; or a point on the "
            "map. If OUT is a folder: several of these, folders, patterns or libraries.",
            metavar="IN",
        ),
    ],
    output: Annotated[
        Path,
        options.output_option(
            "The file to write: {manifold.registries.CONVERTED_IN_WORDS}; or a folder.",
            "OUT",
        ),
    ],
    to: Annotated[
        str | None,
        typer.Option(
            "--format",
            "-f",
            metavar="FORMAT",
            help="{manifold.registries.CONVERTED}, if the suffix of OUT is ambiguous. "
            f"[default for folders: {_FORMAT}]",
        ),
    ] = None,
    sample: options.SampleOption = None,
    correction: options.CorrectionOption = None,
    unit: options.UnitOption = None,
    resolution: Annotated[
        int | None,
        typer.Option(
            help="For RGL files: nodes per axis of the outgoing grid. [default: "
            "{manifold.core.defaults.CONVERTED_RESOLUTION}; an RGL file is copied unchanged]",
            metavar="N",
            min=2,
            max=512,
        ),
    ] = None,
    incidences: Annotated[
        int | None,
        typer.Option(
            help="For RGL files: angles of incidence, in addition to the file's own.",
            metavar="N",
            min=2,
            max=512,
        ),
    ] = None,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.MovedLibraryOption = None,
    merge: Annotated[
        bool,
        typer.Option("--merge", help="Treat several files as one sample, even if the sample names differ."),
    ] = False,
    report: options.ReportOption = None,
    workers: WorkerOptions = PER_CORE,
    json: options.JsonOption = None,
) -> None:
    """Convert a BRDF or readings into another format, and report the conversion error.

    Reads RGL files, and those of other programs and instruments, recognised by their content:
    {manifold.registries.FORMATS}. The result is read back and compared at the file's own nodes. Several
    materials are written into a folder, with a table and a picture of all balls.
    """
    from manifold.convert import conversion
    from manifold.convert.targets import Options
    from manifold.formats.recognition import counts_as_readings, is_rgl

    results = terminal.Results(json)
    sources = options.several_materials(inputs, model, library)
    found = None
    if sample is None and not merge and (not output.suffix or is_many(sources, output)):
        found = inputs_of(
            sources, output, lambda path: is_rgl(path) or counts_as_readings(path), samples=True
        )
    if found is not None:
        if unit is not None:
            raise UsageError(
                f"--unit {unit} works only with one file, found several, or a folder; leave it out"
            )
        if report is not None:
            raise UsageError("--report works only with one file, found several, or a folder; leave it out")
        from manifold.many import commands as many

        command = many.conversions(
            to or _FORMAT, correction=correction, options=Options(resolution, incidences)
        )
        make_many(results, command, found, output, workers.executor())
        return
    with progress.shown("Converting"), conversion.conversion_input(sources) as given:
        made = conversion.convert(
            given,
            output,
            to=to,
            sample=sample,
            correction=correction,
            options=Options(resolution, incidences),
            merge=merge,
            unit=unit,
        )
    rows = {**made.rows, "size": terminal.megabytes(output.stat().st_size)}
    if report is not None:
        made.write_report(report, output)
        rows["report"] = report
    rows |= terminal.numbered("note", made.notes)
    results.rows(f"{output}: {made.target}", rows)
    results.document({"path": output, **made.to_json()})
