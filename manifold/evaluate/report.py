"""Evaluates a fitted manifold and other methods: errors, colour, plausibility, calibration, times and sizes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility
from manifold.core import progress, work
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.extras import require
from manifold.core.metrics import Errors
from manifold.core.names import counted
from manifold.core.pairs import RusinkiewiczGrid
from manifold.core.records import Array, Indices, evenly_spaced, plain
from manifold.evaluate.coherences import coherences
from manifold.evaluate.cross_validation import (
    BYTES_PER_NUMBER,
    Encoded,
    Method,
    cross_validate,
    encode_all,
    leave_out,
    wall_clock,
)
from manifold.evaluate.errors import (
    MethodErrors,
    PredictionErrors,
    colour_errors,
    measure_errors,
    plausibility_results,
    standardised_error,
)
from manifold.evaluate.method_data import Data, band_shares, block_pairs
from manifold.evaluate.methods import PUBLISHED, baseline_methods, gplvm_methods, standard_methods
from manifold.evaluate.model_methods import model_methods, replaced_keys
from manifold.evaluate.seen_fits import seen_principled
from manifold.gpr import IsolatedLatentsWarning
from manifold.library.store import Library
from manifold.model import gram
from manifold.model.coherence import Coherence, Pair
from manifold.model.combination import Values
from manifold.model.expected_error import Reliability
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialTable
from manifold.model.settings import LEARNT_BANDS, SAMPLE_BANDS

if TYPE_CHECKING:
    from pandas import DataFrame

LONGEST_REFITS = 1e5  # materials times squared samples of each refit: above, a report refits only when asked


@dataclass(frozen=True, kw_only=True)
class MethodResult(MethodErrors):
    """The results of one method in a report.

    Attributes: those of `MethodErrors`, and
        rmse_uncertainty: relative uncertainty of both RMSE, estimated from half of the measured bands; 0 if all bands
            were measured.
        numbers: number of parameters of one material.
        bytes: size of all measured values that predictions need, and of the parameters of all materials.
        fit_seconds, encode_seconds: wall-clock times of one fit, and of encoding one material.
        predict_seconds: wall-clock time of predicting one material on the whole grid, in the bands of the errors.
        negative_share: share of predicted values below zero, before any are set to 0.
        clipped_share: share of values that the method sets to 0 before errors are measured.
        reciprocity_error, max_albedo: largest values over the materials, in the tabulated bands; see `plausibility`.
        standardised_error: z of every material, None if the method gives no variance; see
            `errors.standardised_error`.
        rms_standardised_error: root mean square of z; about 1 if the method's variance is right.
    """

    rmse_uncertainty: float
    numbers: int
    bytes: int
    fit_seconds: float
    encode_seconds: float
    predict_seconds: float
    negative_share: float
    clipped_share: float
    reciprocity_error: float
    max_albedo: float
    standardised_error: tuple[float, ...] | None
    rms_standardised_error: float | None


@dataclass(frozen=True, repr=False)
class Report:
    """The content that `manifold report` prints and writes.

    Attributes:
        names: names of the materials, in the order of all tuples over materials.
        latents: latents of the materials, shape (N, Q), as nested tuples.
        is_synthetic: whether each material's file is marked as synthetic.
        bands: text that describes the bands.
        n_error_bands: number of bands in which errors were measured; colours always use all bands.
        grid: name of the grid of direction pairs.
        n_pairs: size of the grid, including pairs below the horizon.
        settings: settings of the model.
        condition: condition number kappa(K).
        methods: results of the methods, reconstruction first, then methods that predict left-out materials.
        expected_errors: reliability of the model's expected errors, `ball` and `cube_root`; None without calibration.
        coherence: coherence of the model and of other maps of its materials, by title.
        pairs: materials and the materials most similar to them, by index, with the detours of the model.
        left_out: titles of the methods that were omitted because they would have taken long.
        seconds: wall-clock times of the stages of the report.
    """

    names: tuple[str, ...]
    latents: tuple[tuple[float, ...], ...]
    is_synthetic: tuple[bool, ...]
    bands: str
    n_bands: int
    n_error_bands: int
    grid: str
    n_pairs: int
    settings: dict[str, Any]
    condition: float
    methods: tuple[MethodResult, ...]
    expected_errors: dict[str, Reliability] | None
    coherence: dict[str, Coherence]
    pairs: list[Pair]
    left_out: tuple[str, ...]
    seconds: dict[str, float]

    def __repr__(self) -> str:
        return f"<Report: {len(self.names)} materials, {self.bands}, {len(self.methods)} methods>"

    def to_json(self) -> dict[str, Any]:
        """Return the report as plain values, with the program's version; numbers that are not finite become None."""
        return {"program": f"manifold {__version__}", **plain(vars(self))}

    def to_pandas(self) -> DataFrame:
        """Return the errors as a data frame of pandas: a row per method and material.

        Columns are `method`, `title`, `is_held_out`, `material`, and the errors of
        `manifold.core.metrics.Errors`.

        Raises:
            MissingPackageError: pandas is not installed.
        """
        pandas = require("pandas")
        frames = []
        for method in self.methods:
            errors = {kind: values for kind, values in method.errors.known.items() if np.ndim(values) == 1}
            columns = {"method": method.key, "title": method.title, "is_held_out": method.is_held_out}
            frames.append(pandas.DataFrame(columns | {"material": self.names} | errors))
        return pandas.concat(frames, ignore_index=True)


def make_report(
    model: Manifold | Path,
    grid_name: str = "default",
    *,
    library: Path | None = None,
    compare: bool = False,
    all_bands: bool = False,
    principled: bool = False,
    picture: Path | None = None,
    workers: Executor | None = None,
) -> Report:
    """Evaluate a model and other methods on a grid of direction pairs.

    Weights are always found on the default grid, even if the errors are measured on another.

    Args:
        model: a fitted manifold, or its file.
        grid_name: `default`, or `hikichi` for the 1,458,000 pairs of Hikichi & Iwasaki.
        library: path of the model's library, if it was moved.
        compare: also run slow methods: models with other settings, and large models that are fitted once per
            material.
        all_bands: measure errors in all bands, not in about 20 of them.
        principled: also fit Mitsuba's principled to the evaluated materials, for comparison.
        picture: file for a picture of the map; None draws none.
        workers: executor that fits the models without each material; the processes read the model from its file, see
            `work.run`.

    Raises:
        UsageError: the grid is unknown, there are fewer than three materials, or the map has landmarks.
        LibraryError: a material cannot be read.
        ManifoldError: a worker process ended unexpectedly.
    """
    if picture is not None:
        from manifold.pictures import figures, map_figure

        figures.require_writable(picture)
    file = model if isinstance(model, Path) else None
    model = Manifold.load(model, library) if isinstance(model, Path) else model
    if len(model.names) < 3:
        found = counted(len(model.names), "material")
        raise UsageError(
            f"{file or 'the model'}: found {found}, expected at least 3 to leave one out; import more"
        )
    if picture is not None:  # first: an interruption then costs little
        figures.save(map_figure.latent_map(model), picture)
    if model.space.landmarks is not None:
        raise UsageError(
            f"a report on a map of {model.space.materials_in_words}, expected a map without landmarks, because every "
            "material is left out; `manifold info MODEL` lists the errors of some left-out materials"
        )
    grid = RusinkiewiczGrid.named(grid_name)
    replaced = replaced_keys(model)
    own = [*model_methods(model), *(m for m in baseline_methods() if m.key not in replaced)]
    others = [m for m in gplvm_methods() if m.key not in replaced]
    chosen = [m for m in own if compare or not is_long(m, len(model.names), model.bands.count)]
    chosen += [*(others if compare else []), *([seen_principled()] if principled else [])]
    materials, load = wall_clock(lambda: model.materials.with_negative_values())
    data, tabulate = wall_clock(lambda: tabulate_materials(model, materials))
    refitted: dict[str, Encoded] = {}
    if file is not None and workers is not None:
        long = [m for m in chosen if m.refits and m.fits_model]
        refitted = _refit_there(workers, long, len(model.names), file, model.library.path)
    encoded, encode = wall_clock(lambda: _encode(data, chosen, refitted))
    bands = np.arange(model.bands.count) if all_bands else data.bands
    reuse = grid_name == "default" and not all_bands
    blocks = data.blocks() if reuse else _measured_blocks(materials, bands, grid)

    def evaluate_all() -> tuple[tuple[MethodResult, ...], dict[str, Coherence], list[Pair]]:
        predictions = [each.combinations for each in encoded]
        errors = measure_errors(predictions, bands, blocks)
        physical = plausibility_results(materials, data.bands, predictions)
        colours = colour_errors(materials, predictions)
        table = MaterialTable(materials, data.bands)
        results = tuple(
            _result(model, data, *each, table, bands, grid.n_pairs)
            for each in zip(chosen, encoded, errors, physical, colours, strict=True)
        )
        is_published_shown = PUBLISHED in {method.key for method in chosen}
        return results, *coherences(model, data, table, is_published_shown=is_published_shown)

    (results, coherence, pairs), evaluate = wall_clock(evaluate_all)
    return Report(
        names=model.names,
        latents=tuple(tuple(float(v) for v in row) for row in model.X),
        is_synthetic=tuple(model.library.attributes(name).is_synthetic for name in model.names),
        bands=str(model.bands),
        n_bands=model.bands.count,
        n_error_bands=len(bands),
        grid=grid_name,
        n_pairs=grid.n_pairs,
        settings=model.settings.to_json(),
        condition=model.gp.condition,
        methods=results,
        expected_errors=None if model.left_out is None else model.left_out.reliability(),
        coherence=coherence,
        pairs=pairs,
        left_out=tuple(m.title for m in [*own, *others] if m not in chosen),
        seconds={"load": load, "tabulate": tabulate, "encode": encode, "evaluate": evaluate},
    )


def is_long(method: Method, n_materials: int, n_bands: int) -> bool:
    """Return whether a method is too slow for this many materials and bands to run by default."""
    if not method.fits_model:
        return False
    samples = n_materials * min(method.sample_bands or 1, n_bands)
    return n_materials * samples**2 > LONGEST_REFITS


def _encode(data: Data, methods: Sequence[Method], known: Mapping[str, Encoded]) -> list[Encoded]:
    """Return predictions of every material by every method, as weights; `known` has some of them."""
    encoded = []
    for m, method in enumerate(methods):

        def step(done: int, before: int = m * data.n_materials, title: str = method.title) -> None:
            progress.report(before + done, len(methods) * data.n_materials, title)

        with warnings.catch_warnings():  # fits to compare with: nobody uses their maps
            warnings.simplefilter("ignore", IsolatedLatentsWarning)
            encoded.append(known.get(method.key) or encode_all(data, method, step))
    return encoded


def _measured_blocks(
    materials: Sequence[MeasuredBRDF], bands: Indices, grid: RusinkiewiczGrid
) -> Iterator[Values]:
    """Yield measured values on a grid in some bands, block by block."""
    selected = [material.select_bands(bands.tolist()) for material in materials]
    size = block_pairs(len(materials), len(bands))
    total = -(-grid.n_pairs // size)
    for done, (wi, wo, f) in enumerate(gram.value_blocks(selected, grid, size), start=1):
        yield Values(f, wi, wo)
        progress.report(done, total, "direction pairs")


def _result(
    model: Manifold, data: Data, method: Method, encoded: Encoded, errors: PredictionErrors,
    physical: Sequence[Plausibility], colours: Errors[Array], table: MaterialTable, bands: Indices, n_pairs: int,
) -> MethodResult:  # fmt: skip
    """Return all measurements of one method."""
    n_bands, negative = model.bands.count, errors.negative_share
    of_values = errors.of_values(n_pairs, band_shares(bands, n_bands))
    fewer = np.zeros(len(bands))  # every second of the bands stands for all
    fewer[::2] = band_shares(bands[::2], n_bands)
    is_estimate = len(bands) < n_bands
    return MethodResult(
        key=method.key,
        title=method.title,
        is_held_out=method.is_held_out,
        numbers=method.numbers(n_bands),
        bytes=_needed_bytes(model.library, model.names, method),
        fit_seconds=float(np.mean(encoded.fit_times)),
        encode_seconds=sum(encoded.encode_times) / data.n_materials,
        predict_seconds=errors.seconds / data.n_materials,
        errors=table.looks(encoded.combinations) | of_values | colours,
        rmse_uncertainty=_difference(errors.of_values(n_pairs, fewer), of_values) if is_estimate else 0.0,
        negative_share=negative,
        clipped_share=negative if errors.is_clipped else 0.0,
        reciprocity_error=float(np.nanmax([p.reciprocity_error for p in physical])),
        max_albedo=float(np.nanmax([p.max_albedo for p in physical])),
        **_calibration(data, method, encoded),
    )


def _difference(coarse: Errors[Array], fine: Errors[Array]) -> float:
    """Return the relative difference of the RMSE of materials, (N,) each: of the medians, or its median if larger."""
    found = 0.0
    for a, b in ((coarse.rmse, fine.rmse), (coarse.rmse_80, fine.rmse_80)):
        medians = np.array([[np.median(a)], [np.median(b)]])
        for x, y in ((a, b), medians):
            found = max(found, float(np.median(np.abs(x - y) / np.where(y > 0.0, y, 1.0))))
    return found


def _needed_bytes(library: Library, names: Sequence[str], method: Method) -> int:
    """Return the bytes needed to predict: files, or their warps and sample bands, and the numbers of all materials."""
    n_bands = library.bands.count
    unused = 1.0 - min(method.sample_bands or n_bands, n_bands) / n_bands
    files = [library.attributes(name) for name in names]
    return BYTES_PER_NUMBER * method.numbers(n_bands) * len(names) + sum(
        info.bytes - round(unused * 4 * int(np.prod(info.shape))) for info in files
    )


def _calibration(data: Data, method: Method, encoded: Encoded) -> dict[str, Any]:
    """Return standardised errors of left-out materials, if every prediction has a variance."""
    if not method.is_held_out or any(c.variance is None for c in encoded.combinations):
        return {"standardised_error": None, "rms_standardised_error": None}
    z = np.array([standardised_error(data, i, c) for i, c in enumerate(encoded.combinations)])
    return {"standardised_error": tuple(z.tolist()), "rms_standardised_error": float(np.sqrt(np.mean(z**2)))}


_PARTS = 8  # tasks of a method


class _Refits(NamedTuple):
    """The key of a method, and the first and last of the materials that are left out, one after the other."""

    method: str
    first: int
    last: int


def tabulate_materials(model: Manifold, materials: Sequence[MeasuredBRDF]) -> Data:
    """Return the data for all methods, in about 20 bands, which include the sample bands of blends."""
    count = model.bands.count
    bands = np.union1d(evenly_spaced(count, LEARNT_BANDS), evenly_spaced(count, SAMPLE_BANDS))
    return Data.evaluate(materials, RusinkiewiczGrid.named("default"), bands)


def _refit_there(
    workers: Executor, methods: Sequence[Method], n_materials: int, model: Path, library: Path | None,
) -> dict[str, Encoded]:  # fmt: skip
    """Return predictions of every material by methods that are fitted without it, by their keys.

    Workers read the model's file and the materials.
    """
    size = -(-n_materials // _PARTS)
    starts = range(0, n_materials, size)
    tasks = [_Refits(method.key, first, first + size) for method in methods for first in starts]
    parts: dict[_Refits, Encoded] = {}
    for k, encoded, failure in work.run(partial(_refit, model=model, library=library), tasks, workers):
        if encoded is None:
            raise ManifoldError(failure)
        parts[tasks[k]] = encoded
        progress.report(len(parts), len(tasks), tasks[k].method)
    of_method = {m.key: [parts[task] for task in tasks if task.method == m.key] for m in methods}
    return {key: _joined(encoded) for key, encoded in of_method.items()}


def _refit(task: _Refits, *, model: Path, library: Path | None) -> Encoded:
    data, methods = _refitting(model, library)
    splits = leave_out(data.n_materials)[task.first : task.last]
    with warnings.catch_warnings():  # fits to compare with: nobody uses their maps
        warnings.simplefilter("ignore", IsolatedLatentsWarning)
        return cross_validate(data, methods[task.method].fit, splits)


@lru_cache(maxsize=1)
def _refitting(model: Path, library: Path | None) -> tuple[Data, dict[str, Method]]:
    loaded = Manifold.load(model, library)
    methods = {method.key: method for method in [*standard_methods(), *model_methods(loaded)]}
    return tabulate_materials(loaded, loaded.materials.with_negative_values()), methods


def _joined(parts: Sequence[Encoded]) -> Encoded:
    return Encoded(
        tuple(c for part in parts for c in part.combinations),
        tuple(t for part in parts for t in part.fit_times),
        tuple(t for part in parts for t in part.encode_times),
    )
