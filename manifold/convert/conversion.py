"""Implements `manifold convert` between files of BRDFs and of instruments, and measures the conversion error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.spatial import cKDTree

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import LEAST_COSINE
from manifold.colour.correction import read_correction
from manifold.convert.source import (
    ConversionSource,
    in_luminance,
    open_source,
    source_of_prediction,
    with_estimated_spectra,
)
from manifold.convert.targets import Options, target_of
from manifold.core import disk
from manifold.core.defaults import DARKEST
from manifold.core.directions import NEAR_MIRROR_DEG, is_near_mirror
from manifold.core.errors import UsageError
from manifold.core.metrics import Errors
from manifold.core.names import counted, percent
from manifold.core.pairs import cosine_weight
from manifold.core.records import Array, Bands, BsdfFile
from manifold.core.results import Result, derived, entry
from manifold.estimate import reports
from manifold.estimate.predictions import predict
from manifold.estimate.source_files import source_file
from manifold.estimate.sources import FileSource, MaterialSource, PlaceSource
from manifold.formats.readings import Readings
from manifold.io_rgl import read_bsdf
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.pictures import html_page
from manifold.registries import CONVERTED

_SAME_PAIR = 1e-6  # largest difference between unit vectors that were written with nine digits
_LARGE_ERROR = 0.05  # of cube roots; above, its reasons are noted
_SHOWN_SHARE = 0.2  # of the squared error
_FEW = 20  # readings per incidence, of spectrophotometers rather than of goniometers


@dataclass(frozen=True)
class Conversion(Result):
    """The result of a conversion.

    Attributes:
        files: the input files, or the point on the map.
        source, target: texts that name the input and the format of the output.
        nodes: number of nodes of the input at which the written file was compared with it.
        median, percentile_95: median and 95th percentile of the relative error `|f* - f| / |f|` over nodes and bands.
    """

    name: str = field(metadata=entry(row="material"))
    files: tuple[str, ...] = field(metadata=entry(row="file", words=lambda result: list(result.files)))
    source: str = field(metadata=entry(row="from", columns={"from": ()}))
    target: str = field(metadata=entry())
    bands: Bands = field(
        metadata=entry(row="bands", json=lambda result: str(result.bands), columns={"bands": ()})
    )
    nodes: int = field(metadata=entry(row="nodes compared"))
    errors: Errors[float] = field(
        metadata=entry(
            row="error, linear", words=lambda result: percent(result.errors.linear, 2),
            columns={"cube root": ("cube_root",), "linear": ("linear",)},
        )
    )  # fmt: skip

    @property
    @derived(row="error, cube root", words=lambda result: percent(result.cube_root_error, 2), json=False)
    def cube_root_error(self) -> float:
        """The cube-root error of the conversion, see `Errors`."""
        return self.errors.cube_root

    median: float = field(
        metadata=entry(
            row="deviation",
            words=lambda result: (
                f"median {percent(result.median, 2)}, 95 % of values within {percent(result.percentile_95, 2)}"
            ),
        )
    )
    percentile_95: float = field(metadata=entry())
    notes: tuple[str, ...] = field(metadata=entry())

    def write_report(self, path: Path, output: Path) -> None:
        """Write an HTML page about the written file."""
        sections = [html_page.Section("Conversion", self.rows)]
        shown = open_source([output]).interpolated
        if not isinstance(shown, UsageError):
            sections += [reports.balls(shown), reports.gloss(shown)]
        sections.append(html_page.Section("Notes", notes=self.notes))
        html_page.write(path, self.name, f"{output.name}: {self.target}.", sections)


def convert(
    paths: Sequence[Path] | PlaceSource,
    output: Path,
    *,
    to: str | None = None,
    sample: str | None = None,
    correction: Path | None = None,
    options: Options | None = None,
    merge: bool = False,
    unit: str | None = None,
) -> Conversion:
    """Convert a file of a BRDF or of readings into another format, and measure the conversion error.

    Args:
        paths: one file, the files of one specimen, or a point on the map, whose prediction is converted.
        output: the file to write; its suffix chooses the format.
        to: one of `CONVERTED`, if the suffix is ambiguous.
        sample: name of the specimen, for a file with several.
        correction: a colour correction of `manifold calibrate`, which is applied to readings in three bands.
        options: the grid of a written RGL file.
        merge: treat all files as one specimen, even if they name it differently.
        unit: unit of values in files that name none: `brdf`, `factor` or `percent`.

    Raises:
        UsageError: the format is unknown, the output cannot be written, readings do not make a BRDF, or files are of
            different samples.
        FileFormatError: a file has an unknown format, or is damaged.
        BandMismatchError: the correction was learned in other bands.
    """
    target = target_of(output, to)
    disk.require_writable(output)
    name = str(paths) if isinstance(paths, PlaceSource) else str(paths[0])
    files = () if isinstance(paths, PlaceSource) else paths
    if any(path.exists() and output.exists() and path.samefile(output) for path in files):
        raise UsageError(f"{output}: is also the input; name another output")
    learned = None if correction is None else read_correction(correction)
    predicted: DiagnosedPrediction | None = None
    opened: Callable[..., ConversionSource] = partial(
        open_source, files, sample, learned, merge=merge, unit=unit
    )
    if isinstance(paths, PlaceSource):
        if sample is not None or learned is not None:
            raise UsageError(
                f"{paths}: is a prediction, to which --sample and --correction do not apply; leave them out"
            )
        predicted, file = _predicted(paths)
        opened = partial(source_of_prediction, predicted.brdf, file)
    source, notes = opened(), [] if predicted is None else list(predicted.diagnostics)
    is_single, is_rgb = source.nodes.bands.count == 1, source.nodes.bands.is_rgb
    if target.holds == "wavelengths" and is_rgb:
        raise UsageError(
            f"{name}: linear sRGB, but {target.title} has wavelengths; convert a file with spectral bands"
        )
    if target.holds.startswith("RGB") and not is_rgb and not (target.holds == "RGB or one" and is_single):
        if is_single:
            notes.append(f"{source.nodes.bands} is written to all three channels")
        source = opened(rgb=True)
    elif target.holds == "one" and not is_single:
        notes.append(f"luminance (CIE Y under D65) is written: {target.title} holds one band")
        source = in_luminance(source if is_rgb else opened(rgb=True))
    elif target is CONVERTED["rgl"]:
        source = with_estimated_spectra(source)
    notes += target.write(output, source, options or Options()) + target.left_out(source.nodes)
    nodes, back = source.nodes, open_source([output])
    if source.is_readings and len(back.nodes) > len(nodes):
        notes += _gaps(source)
    compared, f_star = _compared(source, back)
    f = compared.values
    floor = DARKEST * float(np.max(np.abs(f), initial=1e-300))
    median, high = np.percentile(np.abs(f_star - f) / np.maximum(np.abs(f), floor), [50, 95]).tolist()
    errors = Errors.of_values(f, f_star, cosine_weight(compared.wi, compared.wo))
    if errors.cube_root > _LARGE_ERROR:
        notes += _reasons(compared, f_star)
    return Conversion(
        nodes.name, tuple(path.name for path in files) or (name,), nodes.instrument, target.title, back.nodes.bands,
        len(f), errors, median, high, (*nodes.notes, *notes),
    )  # fmt: skip


@contextmanager
def conversion_input(sources: Sequence[MaterialSource]) -> Iterator[Sequence[Path] | PlaceSource]:
    """Yield the input of `convert` for a path or point; temporary files of it exist during the block."""
    if len(sources) == 1 and isinstance(sources[0], PlaceSource):
        yield sources[0]
        return
    with ExitStack() as files:
        yield [
            source.path if isinstance(source, FileSource) else files.enter_context(source_file(source))
            for source in sources
        ]


def _predicted(place: PlaceSource) -> tuple[DiagnosedPrediction, BsdfFile]:
    """Return the prediction at a point, and its file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{place.name}.bsdf"
        made = predict(place.model, place.place, path, library=place.library, colour=place.colour)
        return made, read_bsdf(path)


def _reasons(compared: Readings, f_star: Array) -> list[str]:
    """Return a note on the parts of a large cube-root error: negative values, and those near mirror directions."""
    f, weight = compared.values, cosine_weight(compared.wi, compared.wo)[:, None]
    squares = (np.cbrt(weight * f_star) - np.cbrt(weight * f)) ** 2
    is_negative = (f < 0.0) & (f_star >= 0.0)
    is_near = is_near_mirror(compared.wi, compared.wo)
    total = max(float(squares.sum()), np.finfo(float).tiny)
    negative = float(squares[is_negative].sum()) / total
    near = float(np.where(is_negative, 0.0, squares)[is_near].sum()) / total
    parts = [
        f"{percent(share)} {what}"
        for share, what in (
            (negative, "comes from negative values (colours outside sRGB, noise), which are stored as 0"),
            (
                near,
                f"lies within {NEAR_MIRROR_DEG:g} degrees of mirror directions, where the nodes miss the highlight",
            ),
        )
        if share > _SHOWN_SHARE
    ]
    return [f"of the squared cube-root error, {'; '.join(parts)}"] if parts else []


def _gaps(source: ConversionSource) -> list[str]:
    """Return notes on readings that are left out, or too sparse for an accurate interpolation."""
    left_out = int(np.sum(~source.nodes.measured.all(axis=1)))
    notes = [f"{counted(left_out, 'direction')} not measured in all bands: left out"] if left_out else []
    theta = np.rad2deg(source.theta_i_rad)
    if theta.size == 1:
        notes.append(
            f"measured at an incidence of {theta[0]:.4g} degrees only: all others are extrapolated from it"
        )
    elif len(source.nodes) < _FEW * theta.size:
        notes.append(
            f"{len(source.nodes)} readings were interpolated; `manifold complete` also uses a library of materials"
        )
    return notes


def _compared(source: ConversionSource, back: ConversionSource) -> tuple[Readings, Array]:
    """Return the nodes of a source, and the values (P, B) of the written file at them, in 1/sr.

    Readings are compared with readings, row by row, where both were measured; otherwise the result is evaluated at the
    nodes.
    """
    nodes = source.nodes
    if np.any(whole := nodes.measured.all(axis=1)):
        nodes = nodes.select_pairs(np.flatnonzero(whole))
    has_no_brdf = isinstance(back.interpolated, UsageError)
    if back.is_readings and source.is_readings and (has_no_brdf or len(back.nodes) >= len(nodes)):
        tree = cKDTree(np.hstack([back.nodes.wi, back.nodes.wo]))
        distance, row = tree.query(np.hstack([nodes.wi, nodes.wo]))
        if np.all(distance < _SAME_PAIR):
            f, f_star = (np.nan_to_num(values) for values in (nodes.values, back.nodes.values[row]))
            return replace(nodes, values=f), f_star
    is_high = np.minimum(nodes.wi[:, 2], nodes.wo[:, 2]) > LEAST_COSINE
    if isinstance(back.brdf, MeasuredBRDF) and np.any(is_high):
        nodes = nodes.select_pairs(np.flatnonzero(is_high))
    return nodes, back.brdf.eval(nodes.wi, nodes.wo)
