"""Commands about files and libraries: corpus, fetch, import, info."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from manifold.core import progress
from manifold.core.errors import LibraryError, UsageError
from manifold.core.names import percent

from . import options, terminal
from .application import app
from .batch_options import THREADS, ThreadOptions

if TYPE_CHECKING:
    from manifold.brdf.interface import BRDF
    from manifold.estimate.attributes import Found
    from manifold.formats.readings import Readings

ToleranceOption = Annotated[
    float | None,
    typer.Option(
        help="Largest difference of a compact material from the original: {manifold.core.judged_lights.BALL}.  "
        "[default: {manifold.core.defaults.COMPACT_TOLERANCE}]",
        metavar="E",
    ),
]


@app.command(
    "corpus",
    epilog="Example: manifold corpus rgl_like --seed 7",
)
def corpus(
    folder: Annotated[Path, typer.Argument(help="The folder to write; made if missing.", metavar="FOLDER")],
    seed: Annotated[
        int,
        typer.Option(
            help="Seed of the measurement noise; equal seeds give identical files.", metavar="N", min=0
        ),
    ] = 0,
    anisotropic: Annotated[
        bool, typer.Option("--anisotropic", help="Add the 11 anisotropic materials, 110 MB each.")
    ] = False,
    rgb: Annotated[bool, typer.Option("--rgb", help="Write linear sRGB instead of 195 bands.")] = False,
    instrument: Annotated[
        str | None,
        typer.Option(
            help="Write simulated measurements of each material by this instrument instead, with noise: "
            "{manifold.registries.INSTRUMENTS}.",
            metavar="NAME",
        ),
    ] = None,
    json: options.JsonOption = None,
) -> None:
    """Write the built-in corpus: 51 synthetic materials, measured by a virtual goniometer."""
    from manifold.analytic import virtual_instruments
    from manifold.analytic.corpus import write
    from manifold.library.identity import require_outside_libraries

    if instrument is not None and (anisotropic or rgb):
        raise UsageError(
            "--instrument with --anisotropic or --rgb: an instrument measures the built-in isotropic corpus in its own "
            "bands; leave them out"
        )
    require_outside_libraries(folder, into=True)
    with progress.shown("Measuring synthetic materials"):
        if instrument is not None:
            paths = virtual_instruments.write(folder, instrument, seed=seed)
        else:
            paths = write(folder, seed=seed, anisotropic=anisotropic, rgb=rgb)
    size = sum(path.stat().st_size for path in paths)
    results = terminal.Results(json)
    rows = {"files": len(paths), "size": terminal.megabytes(size), "seed": seed}
    results.rows(f"Synthetic corpus in {folder}", rows)
    results.document({"seed": seed, "bytes": size, "files": paths})


@app.command(
    "fetch",
    epilog="Example: manifold fetch satin_gold paper_blue -o rgl",
)
def fetch(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Names of materials; without names, all 51 isotropic ones.", metavar="NAME"),
    ] = None,
    output: Annotated[Path, options.output_option("The folder for the files.", "FOLDER")] = Path("rgl"),
    base_url: Annotated[
        str | None, typer.Option(help="Another server with the same folders and files.", metavar="URL")
    ] = None,
    anisotropic: Annotated[
        bool, typer.Option("--anisotropic", help="Without names: also the 11 anisotropic materials.")
    ] = False,
    rgb: Annotated[
        bool,
        typer.Option(
            "--rgb", help="RGB files instead of spectral ones; without names the 20 that the evaluation uses."
        ),
    ] = False,
    json: options.JsonOption = None,
) -> None:
    """Download measured materials of the RGL database and verify their checksums.

    Measured by J. Dupuy and W. Jakob (EPFL), in the public domain (CC0 1.0).
    """
    from manifold.library import fetch as fetching

    results = terminal.Results(json)
    with progress.shown("Downloading", in_bytes=True):
        result = fetching.fetch(
            names or None,
            output,
            base_url=base_url or fetching.BASE_URL,
            anisotropic=anisotropic,
            rgb=rgb,
        )
    results.rows(
        f"Files in {output}",
        {
            "downloaded": len(result.downloaded),
            "already there": len(result.present),
            "without a known checksum": ", ".join(result.without_checksum) or "none",
        },
    )
    results.document(
        {
            "downloaded": result.downloaded,
            "present": result.present,
            "without_checksum": result.without_checksum,
        },
    )


@app.command(
    "import",
    epilog="Example: manifold import rgl --library library.zarr",
)
def import_(
    sources: Annotated[list[Path], typer.Argument(help=".bsdf files, or folders of them.", metavar="SOURCE")],
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Replace materials whose file has changed, or that are stored in the other form (compact or not).",
        ),
    ] = False,
    compact: Annotated[
        bool, typer.Option("--compact", help="Compress the materials with loss, like `manifold compact`.")
    ] = False,
    tolerance: ToleranceOption = None,
    rotation: Annotated[
        str | None,
        typer.Option(
            "--rotation",
            help="Azimuth in degrees by which anisotropic samples were rotated; predictions rotate them back. auto "
            "estimates it: the axis along which highlights are widest becomes x.",
            metavar="DEG|auto",
        ),
    ] = None,
    workers: ThreadOptions = THREADS,
    json: options.JsonOption = None,
) -> None:
    """Import .bsdf files or folders into a library, which is created if missing.

    Materials are added atomically; those already in the library are skipped.
    """
    from manifold.core.defaults import COMPACT_TOLERANCE
    from manifold.library.importing import import_files, readings_note

    if tolerance is not None and not compact:
        raise UsageError(
            "--tolerance without --compact: nothing is approximated; add --compact, or leave it out"
        )
    if compact and tolerance is None:
        tolerance = COMPACT_TOLERANCE
    results = terminal.Results(json)
    with progress.shown("Importing"), workers.executor() as executor:
        result = import_files(
            library, sources, replace=replace, tolerance=tolerance, rotation_rad=_rotation(rotation), workers=executor
        )  # fmt: skip
    results.rows(
        f"Library {library}",
        {
            "imported": len(result.imported),
            "replaced": len(result.replaced),
            "already present": len(result.skipped),
            "failed": len(result.failed),
            **({"not imported": readings_note(result.readings)} if result.readings else {}),
        },
    )
    results.document({"library": library, **vars(result)})
    if result.failed:
        raise LibraryError(_shortened(list(result.failed.values()), "failed"))


def _rotation(text: str | None) -> float | Literal["auto"] | None:
    """Parse an azimuth in radians."""
    if text is None:
        return None
    if text == "auto":
        return "auto"
    try:
        degrees = float(text)
    except ValueError:
        degrees = math.nan
    if not abs(degrees) <= 180.0:
        raise UsageError(f"--rotation {text}: expected degrees from -180 to 180, or auto")
    return math.radians(degrees)


@app.command(
    "compact",
    epilog="Example: manifold compact library.zarr --tolerance 0.1",
)
def compact(
    library: Annotated[
        Path, typer.Argument(help="The library.", metavar="LIBRARY")
    ] = options.DEFAULT_LIBRARY,
    tolerance: ToleranceOption = None,
    json: options.JsonOption = None,
) -> None:
    """Compress a library to a few per cent of its size, within a bound on the error of the ball.

    Each compact material is compared with the original, which is then removed: keep the imported files if you need them
    bit for bit. All commands read compact libraries, and earlier models stay valid. The bound on the cube-root error
    is proportional to the tolerance.
    """
    from manifold.core.defaults import COMPACT_TOLERANCE
    from manifold.core.judged_lights import BALL
    from manifold.library.compacting import compact_library
    from manifold.library.store import Library

    results = terminal.Results(json)
    before = Library(library).disk_bytes
    with progress.shown("Compacting"):
        result = compact_library(library, COMPACT_TOLERANCE if tolerance is None else tolerance)
    after, errors = Library(library).disk_bytes, list(result.compacted.values())
    rows: dict[str, object] = {"compacted": len(errors), "already compact": len(result.skipped)}
    if errors:
        rows["largest errors"] = [
            f"{max(e.ball for e in errors):.2f} {BALL}",
            f"{percent(max(e.cube_root for e in errors), 2)} cube-root error",
        ]
    rows["unchanged"] = len(result.failed)
    rows["size"] = f"{terminal.megabytes(after)}, before {terminal.megabytes(before)}"
    results.rows(f"Library {library}", rows)
    results.document({"library": library, **vars(result), "bytes_before": before, "bytes_after": after})
    if result.failed:
        raise LibraryError(_shortened(list(result.failed.values()), "unchanged"))


@app.command(
    "info",
    epilog="Example: manifold info library.zarr --verify",
)
def info(
    path: Annotated[
        str,
        typer.Argument(
            help="A .bsdf file or an instrument's file, a library, a model, or a fit's JSON; a material of the "
            "library; or a point on the map (X,Y or FROM:TO:T).",
            metavar="PATH",
        ),
    ] = str(options.DEFAULT_LIBRARY),
    verify: Annotated[
        bool, typer.Option("--verify", help="Read a whole library and compare every hash.")
    ] = False,
    model: options.ModelOption = options.DEFAULT_MODEL,
    system: Annotated[
        bool,
        typer.Option("--system", help="Show versions, extras and the renderer of this installation instead."),
    ] = False,
    library: options.MovedLibraryOption = None,
    json: options.JsonOption = None,
) -> None:
    """Show what a file, a library, a model, or a fit contains.

    Files may be RGL files, or those of other programs and instruments, recognised by their content:
    {manifold.registries.FORMATS}.
    """
    results = terminal.Results(json)
    if system:
        from manifold.cli.system import describe

        installation, document = describe()
        results.rows("This installation", installation)
        results.document(document)
        return
    from manifold.convert import contents as info

    with progress.shown("Verifying" if verify else "Reading"):
        exported = info.inspect_export(Path(path))
        shown = exported or info.inspect_source(
            options.material_source(path, model, library), library=library, verify=verify
        )
    results.rows(shown.title, shown.rows)
    for columns, rows in shown.tables:
        if rows:
            results.text("\n")
            results.table(columns, rows)
    results.document(shown.document)
    if shown.problems:
        raise LibraryError(_shortened(shown.problems, "damaged"))


def _shortened(messages: list[str], what: str) -> str:
    """Return the first three messages, behind their number."""
    return (f"{len(messages)} {what}: " if messages[1:] else "") + terminal.first_three(messages)


@app.command(
    "find",
    epilog="Example: manifold find --lab 50,20,10 --gloss 60=30, or manifold find readings.xlsx",
)
def find(
    material: Annotated[
        str | None,
        typer.Argument(
            help="A file of a BRDF or of readings, a material of the library, or a point on the map (X,Y or "
            "FROM:TO:T).",
            metavar="MATERIAL",
            show_default=False,
        ),
    ] = None,
    lab: Annotated[
        str | None,
        typer.Option(
            help="CIELAB colour L*, a*, b* measured at 45/0 (not d/8), with commas between; or a file with one colour "
            "per line: name, L, a, b.",
            metavar="L,a,b|FILE",
        ),
    ] = None,
    viewing: options.ViewingOptions = options.DAYLIGHT,
    gloss: Annotated[
        list[str] | None,
        typer.Option(help="Gloss units at 20, 60 or 85 degrees; may be repeated.", metavar="60=UNITS"),
    ] = None,
    sample: options.SampleOption = None,
    count: Annotated[int, typer.Option(help="How many to list.", metavar="N", min=1)] = 10,
    model: options.ModelOption = options.DEFAULT_MODEL,
    library: options.LibraryOption = options.DEFAULT_LIBRARY,
    json: options.JsonOption = None,
) -> None:
    """List the materials of a library nearest to a material, or to a colour, a gloss, or both.

    The distance from a BRDF is the CIEDE2000 of balls in {manifold.core.judged_lights.LIGHTS}; from readings, the
    CIEDE2000 at their geometries; from --lab, the CIEDE2000 at 45/0 under D65 and the 2 degree observer. A factor of
    1.2 in gloss counts as a CIEDE2000 of 1. With a colour and a gloss, the distance is the root of the sum of squares.
    """
    from manifold.estimate import attributes, coat, completions
    from manifold.formats.readings import Readings
    from manifold.library.store import Library

    if (material is None) == (lab is None and not gloss):
        raise UsageError(
            "expected a MATERIAL, or --lab or --gloss or both, found "
            + ("nothing" if material is None else "both kinds")
        )
    results = terminal.Results(json)
    units = completions.parse_gloss(gloss or [])
    opened = Library(library)
    if lab is not None and Path(lab).is_file():
        document = {}
        with progress.shown("Reading materials"):
            colours = coat.read_colours(Path(lab), units, viewing.given)
            nearest = {
                one.name: attributes.find(opened, lab=one.lab, gloss=one.gloss)[:count] for one in colours
            }
        for name, some in nearest.items():
            results.text(f"{name}:\n")
            _show_found(results, some)
            document[name] = [one.to_json() for one in some]
        results.document({"found": document})
        return
    with progress.shown("Reading materials"):
        sought = None if material is None else _sought(material, sample, model, library)
        colour = None if lab is None else completions.parse_lab(lab, viewing.viewing())
        found = attributes.find(opened, sought, lab=colour, gloss=units)
    _show_found(results, found[:count])
    notes = sought.notes if isinstance(sought, Readings) else ()
    for note in notes:
        results.sentence(f"note: {note}")
    results.document({"found": found[:count], "notes": notes})


def _sought(text: str, sample: str | None, model: Path, library: Path) -> BRDF | Readings:
    """Read the material of a file, name or point; readings if a file has such."""
    from manifold.brdf.measured import MeasuredBRDF
    from manifold.estimate.source_files import read_source
    from manifold.estimate.sources import FileSource, parse_source
    from manifold.formats import registry
    from manifold.formats.recognition import is_readings

    source = parse_source(text, model, library)
    if isinstance(source, FileSource) and is_readings(source.path):
        return registry.read_readings(source.path, sample)
    return MeasuredBRDF(read_source(source))


def _show_found(results: terminal.Results, found: Sequence[Found]) -> None:
    angles = list(found[0].gloss) if found else []
    heads = [f"CIEDE2000 ({found[0].light})"] if found and found[0].light else []
    has_distance = any(one.distance != one.ciede2000 for one in found)
    results.table(
        [
            "material", *["distance"] * has_distance, "L* (45/0, D65/2)", "a*", "b*", *heads,
            *(f"gloss {a:g}" for a in angles),
        ],
        [
            (
                one.name, *[f"{one.distance:.1f}"] * has_distance, *(f"{v:.1f}" for v in one.lab),
                *([] if one.ciede2000 is None else [f"{one.ciede2000:.1f}"]),
                *(f"{one.gloss[a]:.3g}" for a in angles),
            )
            for one in found
        ],
    )  # fmt: skip
