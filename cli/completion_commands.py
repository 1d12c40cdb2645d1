"""Commands about readings: complete, calibrate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manifold.core import progress
from manifold.core.errors import UsageError
from manifold.core.names import first_few

from . import options, photograph_commands, terminal
from .application import app
from .batch_options import PER_CORE, WorkerOptions, make_many, require_folder
from .outputs import checked, or_default

if TYPE_CHECKING:
    from manifold.core.records import Array
    from manifold.estimate.coat import Coated
    from manifold.estimate.completions import Completed
    from manifold.estimate.suggestions import Suggested
    from manifold.formats.readings import GlossUnits
    from manifold.many.batch import BatchCommand

    from .batch_options import S


_OF_A_COLOUR = "completed.bsdf"  # the file of a colour, which has no name


@dataclass(frozen=True)
class LabOptions(options.ViewingOptions):
    """A colour instead of readings."""

    lab: Annotated[
        str | None,
        typer.Option(
            help="Instead of READINGS: a CIELAB colour L*, a*, b* measured at 45/0 (not d/8), with --gloss if it is "
            "known; or a file with one colour per line: name, L, a, b. A header may name columns gloss_20, gloss_60, "
            "gloss_85.",
            metavar="L,a,b|FILE",
        ),
    ] = None
    mixture: Annotated[
        bool,
        typer.Option(
            "--mixture",
            help="With --lab and --gloss: mix the library's materials, metals included. Without --mixture, the result "
            "is a dielectric coat over a diffuse base, which matches colour and gloss.",
        ),
    ] = False

    @property
    def parsed(self) -> Array:
        """The given colour as CIELAB (3,) under D65 and the 2 degree observer."""
        from manifold.estimate import completions

        return completions.parse_lab(self.lab or "", self.viewing())

    @property
    def is_file(self) -> bool:
        """Whether the options name a file of colours."""
        return self.lab is not None and Path(self.lab).is_file()


@dataclass(frozen=True)
class MadeOptions(options.FileOptions):
    """Options for the outputs of an estimate."""

    picture: Annotated[
        bool,
        typer.Option(
            "--picture",
            help="Also render the ball of the result, into NAME.png; for several samples, a sheet of balls is always "
            "drawn.",
        ),
    ] = False
    report: options.ReportOption = None
    suggest: Annotated[
        int,
        typer.Option(
            help="Also suggest this many directions to measure next; without READINGS, to measure first.",
            metavar="K",
            min=0,
            max=100,
        ),
    ] = 0
    instrument: Annotated[
        str | None,
        typer.Option(help="Suggest among the directions of ma-t12 or mini-diff.", metavar="NAME"),
    ] = None

    def ball(self, target: Path) -> Path | None:
        """Return the path for the picture of a file's ball; None if no picture is requested."""
        return checked(target.with_suffix(".png"), "picture") if self.picture else None


NO_LAB, USUAL = LabOptions(), MadeOptions()
"""None of these options."""


@app.command(
    "complete",
    epilog="Example: manifold complete sample.xlsx -o sample_spec.bsdf --picture --suggest 3",
)
def complete(
    readings: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Files of readings, or folders that contain them. Readings of one sample from several instruments are "
            "merged by its name.",
            metavar="READINGS",
            show_default=False,
        ),
    ] = None,
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    output: Annotated[
        Path | None,
        options.output_option(
            "The file to write, or the folder. [default: the sample's name, .bsdf; "
            f"{_OF_A_COLOUR} for --lab; or completions]"
        ),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option("--into", help="Also import the completed samples into this library.", metavar="FOLDER"),
    ] = None,
    merge: Annotated[
        bool, typer.Option("--merge", help="Treat all files as one sample, even if the sample names differ.")
    ] = False,
    sample: options.SampleOption = None,
    correction: options.CorrectionOption = None,
    gloss: options.GlossOption = None,
    unit: options.UnitOption = None,
    repeatability: Annotated[
        float | None,
        typer.Option(
            help="Repeatability of the instrument, in per cent of a reading; the completion reproduces "
            "readings to that accuracy.  [default: {manifold.core.defaults.REPEATABILITY:.2%} "
            "for spectrophotometers, {manifold.core.defaults.GONIOMETER:.0%} for goniometers]",
            metavar="PERCENT",
            min=0.0,
            max=100.0,
        ),
    ] = None,
    colour: LabOptions = NO_LAB,
    asked: MadeOptions = USUAL,
    workers: WorkerOptions = PER_CORE,
    json: options.JsonOption = None,
) -> None:
    """Estimate a whole BRDF from readings of a material, with a library of materials as prior.

    Reports the expected error, the residual of the readings, and the mixtures of materials that explain them. Several
    samples are completed into a folder, with a table and a picture of all balls; results of an earlier run are
    kept. A report (--report) of several samples has an index and a page per sample.
    """
    from manifold.estimate import completions, inputs, instruments, reports
    from manifold.estimate.attributes import readings_of_colour
    from manifold.library.store import Library

    results, given = terminal.Results(json), readings or []
    _require_consistent(given, colour, asked)
    if not given and colour.lab is None:
        _suggest_first(results, library, asked)
        return
    units = completions.parse_gloss(gloss or [])

    def make_folder(command: BatchCommand[S], sources: Sequence[S], outputs: str) -> None:
        then = None if into is None else partial(many.import_outputs, library=into)
        make_many(results, command, sources, output, workers.executor(), outputs=outputs, then=then)

    if colour.is_file:
        from manifold.estimate import coat
        from manifold.many import commands as many

        colours = coat.read_colours(Path(colour.lab or ""), units, colour.given)
        command = many.coats(library, is_mixture=colour.mixture, options=asked.written)
        make_folder(command, colours, f"{len(colours)} colours")
        return
    if (
        unit is not None
        and sample is None
        and not merge
        and (len(given) > 1 or any(p.is_dir() for p in given))
    ):
        raise UsageError(
            "--unit works only with one file of readings; add --merge if the files are of one sample, or complete each "
            "file by itself"
        )
    if given and sample is None and not merge and unit is None:
        with progress.shown("Reading files"):
            samples = inputs.find_samples(given)
        if len(samples) > 1 or len(samples[0].parts) != len(given) or into or (output and output.is_dir()):
            names = first_few([one.parts[0][1] or one.name for one in samples])
            found = f"{len(samples)} samples ({names}); name one by --sample"
            if units or repeatability is not None:
                raise UsageError(
                    f"--gloss and --repeatability work only with one sample, found {found}, or leave them out"
                )
            from manifold.many import commands as many

            require_folder(output, f"{found}, or a folder")
            inputs.require_apart(given, output or Path("completions"))
            of_samples = many.completions_of(
                library, correction=correction, count=asked.suggest, instrument=asked.instrument,
                options=asked.written, report=asked.report,
            )  # fmt: skip
            make_folder(of_samples, samples, f"{found}, or a folder")
            return
    if into is not None:
        raise UsageError("--into works only with the samples of files; leave --sample, --merge and --lab out")
    if colour.lab is not None and units and not colour.mixture:
        _complete_coat(results, library, colour, units, output, asked)
        return
    if colour.lab is not None:
        taken, learned = readings_of_colour(colour.parsed, units, Library(library).bands), None
        target = or_default(output, _OF_A_COLOUR)
    else:
        taken, learned = (
            instruments.read(given, sample, correction, units, unit)
            if merge or sample is not None or unit is not None
            else instruments.read_sample(samples[0], correction, units)
        )
        target = or_default(output, completions.file_name(taken))
    is_adapted = colour.lab is not None and taken.bands.is_rgb
    if not is_adapted and colour.given is not None:
        taken = taken.seen_under(colour.viewing(taken.viewing))
    if repeatability is not None:
        taken = replace(taken, repeatability=repeatability / 100.0)
    ball = asked.ball(target)
    with progress.shown("Completing"):
        made = completions.complete(
            library, taken, target, correction=learned, picture=ball, count=asked.suggest,
            instrument=asked.instrument, options=asked.written,
        )  # fmt: skip
    if asked.report is not None:
        reports.write_completion(asked.report, made, given)
    _show(results, made, asked, given)


def _require_consistent(readings: Sequence[Path], colour: LabOptions, asked: MadeOptions) -> None:
    """Raise UsageError if options contradict each other, or need others that are not given."""
    if readings and colour.lab is not None:
        raise UsageError(
            f"found --lab {colour.lab} and readings {readings[0]}, expected one of them; a colour has commas, such as "
            "50,20,10; --merge combines readings of a spectrophotometer with others"
        )
    has_input = bool(readings) or colour.lab is not None
    if asked.report is not None and not has_input:
        raise UsageError("--report works only with readings or a colour; leave it out")
    if colour.mixture and colour.lab is None:
        raise UsageError("--mixture works only with --lab; leave it out")
    if not has_input and not asked.suggest:
        raise UsageError(
            "no readings are given; give a file, or --suggest K for the directions to measure first"
        )
    if asked.instrument is not None and not asked.suggest:
        raise UsageError("--instrument restricts the suggested directions; also give --suggest K")
    for option, given in (("--report", asked.report), ("--suggest", asked.suggest)):
        if colour.is_file and given:
            raise UsageError(f"{option} works only with readings or one colour, found a list; leave it out")


def _suggest_first(results: terminal.Results, library: Path, asked: MadeOptions) -> None:
    """Print the directions to measure first."""
    from manifold.estimate import suggestions

    first = suggestions.suggest(library, asked.suggest, None, asked.instrument)
    _show_suggested(results, first, "Measure first", asked.instrument)
    results.document({"suggested_deg": first.angles_deg.tolist()})


def _complete_coat(
    results: terminal.Results, library: Path, colour: LabOptions, units: GlossUnits,
    output: Path | None, asked: MadeOptions,
) -> None:  # fmt: skip
    """Complete one colour and gloss by a coat over a diffuse base, and print the result."""
    from manifold.estimate import coat, reports

    L, a, b = colour.parsed.tolist()
    one = coat.ColourSample(f"L {L:.4g}, a {a:.4g}, b {b:.4g}", (L, a, b), units)
    target = or_default(output, _OF_A_COLOUR)
    ball = asked.ball(target)
    with progress.shown("Completing"):
        made = coat.complete(
            library, one, target, picture=ball, count=asked.suggest, instrument=asked.instrument,
            options=asked.written,
        )  # fmt: skip
    if asked.report is not None:
        reports.write_coat(asked.report, made)
    _show(results, made, asked)


def _show(
    results: terminal.Results, made: Completed | Coated, asked: MadeOptions, readings: Sequence[Path] = ()
) -> None:
    """Print a completed material, and the next directions to measure if they were asked for."""
    photograph_commands.show_completed(results, made, asked.report, readings)
    if made.suggested is not None:
        _show_suggested(results, made.suggested, "\nMeasure next", asked.instrument)
    results.document(made)


@app.command(
    "calibrate",
    epilog="Example: manifold calibrate red.xlsx red.astm blue.xlsx blue.astm -o mini-diff.json",
)
def calibrate(
    pairs: Annotated[
        list[Path],
        typer.Argument(
            help="The reference's file or folder, then the other's, for one or several samples. Samples with the same "
            "name in both are used.",
            metavar="REF OTHER ...",
        ),
    ],
    output: Annotated[Path, options.output_option("The correction to write, as JSON.")] = Path(
        "correction.json"
    ),
    allow_harm: Annotated[
        bool,
        typer.Option(
            "--allow-harm",
            help="Also write a correction that is worse than none.",
        ),
    ] = False,
    report: options.ReportOption = None,
    json: options.JsonOption = None,
) -> None:
    """Fit the colour correction of a camera-based instrument to a spectrophotometer, over several samples.

    Cross-validates linear, root-polynomial and Cheung's polynomial forms, leaving out one sample at a time. Chooses the
    form with the smallest error, if possible among those that make at most a quarter of the samples worse. Does not
    write a correction that is worse than none on average, or for more than half of the samples (see --allow-harm). Give
    six or more samples of different colours: one sample corrects only its own colour.
    """
    from manifold.estimate import instruments, reports

    results = terminal.Results(json)
    with progress.shown("Calibrating"):
        calibrated = instruments.calibrate(pairs, output, allow_harm=allow_harm)
    results.rows(f"Colour correction {output}", calibrated.rows)
    one_sample = len(calibrated.samples) == 1
    left_out = "reading by reading of the one sample" if one_sample else "sample by sample"
    results.text(f"\nLeave-one-out relative error, {left_out}:\n")
    results.table(
        ("form", "error", "chosen"),
        [
            (each, "not measured" if error != error else f"{error:.4f}", "*" * (each == calibrated.form))
            for each, error in calibrated.errors.items()
        ],
    )
    results.text("\nCIEDE2000 (D65, 2 degrees) to the reference, left out, mean over readings:\n")
    results.table(
        ("sample", "uncorrected", "corrected"),
        [
            (name, *("unknown" if off != off else f"{off:.2f}" for off in row))
            for name, row in calibrated.ciede2000
        ],
    )
    if report is not None:
        reports.write_calibration(report, calibrated)
        results.text(f"Report: {report}\n")
    for note in calibrated.notes:
        results.sentence(f"note: {note}")
    results.document(calibrated)


def _show_suggested(
    results: terminal.Results, suggested: Suggested, title: str, instrument: str | None
) -> None:
    of = instrument or "a goniometer up to 80 degrees (or --instrument ma-t12 or mini-diff)"
    results.text(f"{title} with {of}. Angles in degrees, azimuth 0 on the side of the mirror direction:\n")
    results.table(
        ("incidence", "outgoing", "azimuth"),
        [tuple(f"{angle:.0f}" for angle in row) for row in suggested.angles_deg],
    )
