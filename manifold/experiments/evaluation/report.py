"""How good a fitted manifold is beside other methods: errors, colour, plausibility, calibration, times, bytes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from manifold import __version__
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.plausibility import Plausibility, plausibilities
from manifold.colour.difference import colour_differences, illuminants_for, multi_angle_pairs
from manifold.experiments.evaluation.heldout import Encoded, encode_all
from manifold.experiments.evaluation.methods import SAMPLE_BANDS, Method, baseline_methods, gplvm_methods
from manifold.experiments.evaluation.model_methods import model_methods, replaced_keys
from manifold.experiments.evaluation.tabulated import MAX_BANDS, Data
from manifold.metrics import RusinkiewiczGrid, cosine_weight, norm_ratio
from manifold.model import gram
from manifold.model.combination import Values, evaluate
from manifold.model.manifold import Manifold
from manifold.records import Array, Progress, evenly_spaced

LONGEST_REFITS = 1e5  # materials times squared samples of each refit: above, a report refits only when asked
_BLOCK_VALUES = 10_000_000  # measured values held at once, of all materials together
_BYTES_PER_NUMBER = 8


@dataclass(frozen=True)
class ColourResult:
    """Colour errors of one method under one illuminant, means over six multi-angle geometries.

    Attributes:
        illuminant: its CIE name.
        delta_e: CIEDE2000 per material.
        median_delta_e: of them.
        spectral_angle_deg: per material.
        median_spectral_angle_deg: of them.
    """

    illuminant: str
    delta_e: tuple[float, ...]
    median_delta_e: float
    spectral_angle_deg: tuple[float, ...]
    median_spectral_angle_deg: float


@dataclass(frozen=True)
class MethodResult:
    """What one method makes of all materials.

    Attributes:
        key, title, is_held_out: as in `Method`.
        numbers: that describe one material.
        bytes: of all measured values that predictions need, and of the numbers of all materials.
        fit_seconds: wall-clock time of one fit.
        encode_seconds: wall-clock time of encoding one material.
        predict_seconds: wall-clock time of predicting one material on the whole grid, in the bands of errors.
        rmse: eq. 22 of Hikichi & Iwasaki per material, in 1/sr: summed over all bands, as those of errors have it.
        relative_error: cosine-weighted, per material.
        median_relative_error, p90_relative_error: over materials.
        negative_share: share of predicted values below zero.
        clipped_share: share of values that were below zero before the method cut them to 0.
        reciprocity_error: worst over materials, in the tabulated bands; see `plausibility`.
        max_albedo: worst over materials, in the tabulated bands.
        colour: per illuminant; see `colour_difference`.
        standardised_error: z per material, None where the method gives no variance; see
            `heldout.standardised_error`.
        rms_standardised_error: root mean square of z; about 1 where the method's variance is right.
    """

    key: str
    title: str
    is_held_out: bool
    numbers: int
    bytes: int
    fit_seconds: float
    encode_seconds: float
    predict_seconds: float
    rmse: tuple[float, ...]
    relative_error: tuple[float, ...]
    median_relative_error: float
    p90_relative_error: float
    negative_share: float
    clipped_share: float
    reciprocity_error: float
    max_albedo: float
    colour: tuple[ColourResult, ...]
    standardised_error: tuple[float, ...] | None
    rms_standardised_error: float | None


@dataclass(frozen=True)
class Report:
    """What `manifold report` prints and writes.

    Attributes:
        names: materials, in the order of all per-material tuples.
        latents: shape (N, Q) as nested tuples.
        is_synthetic: per material, whether its file says so.
        bands: the spectral axis in words.
        n_error_bands: in how many bands errors were measured; colours always use all.
        grid: name of the grid of direction pairs.
        n_pairs: its size, pairs below the horizon included.
        settings: of the model.
        condition: kappa(K).
        methods: reconstruction first, then what was held out.
        left_out: titles of the methods that would have taken long.
        seconds: of the stages of the report, wall-clock.
    """

    names: tuple[str, ...]
    latents: tuple[tuple[float, ...], ...]
    is_synthetic: tuple[bool, ...]
    bands: str
    n_error_bands: int
    grid: str
    n_pairs: int
    settings: dict[str, Any]
    condition: float
    methods: tuple[MethodResult, ...]
    left_out: tuple[str, ...]
    seconds: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        """The report as plain values, with the program's version; numbers that are not finite become None."""
        return {"program": f"manifold {__version__}", **_finite(asdict(self))}


def make_report(
    model: Manifold,
    grid_name: str = "default",
    on_progress: Progress | None = None,
    *,
    compare: bool = False,
    all_bands: bool = False,
) -> Report:
    """Evaluate a model and other methods on a grid of direction pairs.

    Weights are found on the default grid, whichever the errors are measured on.

    Args:
        model: a fitted manifold.
        grid_name: `default`, or `hikichi` for the 1,458,000 pairs of Hikichi & Iwasaki.
        on_progress: called with (done, total, what).
        compare: also run what takes long: models of other settings, and large ones that are fitted once per
            material.
        all_bands: measure errors in all bands, not in about 20 of them.
    Raises:
        UsageError: the grid is unknown.
        LibraryError: a material cannot be read.
    """
    grid = RusinkiewiczGrid.named(grid_name)
    replaced = replaced_keys(model)
    own = [*model_methods(model), *(m for m in baseline_methods() if m.key not in replaced)]
    others = [m for m in gplvm_methods() if m.key not in replaced]
    chosen = [m for m in own if compare or not is_long(m, len(model.names), model.bands.count)]
    chosen += others if compare else []
    materials, load = _timed(lambda: model.load_materials(on_progress))
    data, tabulate = _timed(lambda: _tabulate(model, materials, on_progress))
    encoded, encode = _timed(lambda: _encode(data, chosen, on_progress))
    bands = np.arange(model.bands.count) if all_bands else data.bands
    reuse = grid_name == "default" and not all_bands
    blocks = _tabulated_blocks(data) if reuse else _blocks(materials, bands, grid, on_progress)
    results, evaluate_seconds = _timed(
        lambda: _evaluate(model, materials, data, encoded, blocks, bands, grid.n_pairs)
    )
    return Report(
        names=model.names,
        latents=tuple(tuple(float(v) for v in row) for row in model.X),
        is_synthetic=tuple(model.library.attributes(name).is_synthetic for name in model.names),
        bands=str(model.bands),
        n_error_bands=len(bands),
        grid=grid_name,
        n_pairs=grid.n_pairs,
        settings=dict(vars(model.settings)),
        condition=model.gp.condition,
        methods=results,
        left_out=tuple(m.title for m in [*own, *others] if m not in chosen),
        seconds={"load": load, "tabulate": tabulate, "encode": encode, "evaluate": evaluate_seconds},
    )


def is_long(method: Method, n_materials: int, n_bands: int) -> bool:
    """Whether a method takes too long on so many materials of so many bands to run unasked."""
    if not method.fits_model:
        return False
    samples = n_materials * min(method.sample_bands or 1, n_bands)
    return n_materials * samples**2 > LONGEST_REFITS


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def _tabulate(model: Manifold, materials: Sequence[MeasuredBRDF], on_progress: Progress | None) -> Data:
    """What methods learn from: about 20 bands, those among them that are samples of monochrome models."""
    count = model.bands.count
    bands = np.union1d(evenly_spaced(count, MAX_BANDS), evenly_spaced(count, SAMPLE_BANDS))
    if model.space.sample_bands is not None:
        bands = np.union1d(bands, model.space.sample_bands)

    def step(done: int, total: int) -> None:
        if on_progress is not None:
            on_progress(done, total, "direction pairs")

    return Data.evaluate(materials, RusinkiewiczGrid.named("default"), bands, step)


def _encode(data: Data, methods: Sequence[Method], on_progress: Progress | None) -> list[Encoded]:
    """Predictions of every material by every method, as weights."""
    encoded = []
    for m, method in enumerate(methods):

        def step(done: int, before: int = m * data.n_materials, title: str = method.title) -> None:
            if on_progress is not None:
                on_progress(before + done, len(methods) * data.n_materials, title)

        encoded.append(encode_all(data.unmapped(), method, step))
    return encoded


class _Errors:
    """Sums over direction pairs of one method's errors, material by material."""

    def __init__(self, encoded: Encoded, bands: Array) -> None:
        self.encoded = encoded
        self.combinations = [c.in_bands(bands) for c in encoded.combinations]
        self.squared = np.zeros(len(self.combinations))
        self.weighted = np.zeros(len(self.combinations))
        self.negative = 0
        self.seconds = 0.0

    @property
    def is_clipped(self) -> bool:
        """Whether the method cuts negative values to 0."""
        return self.combinations[0].is_clipped

    def add(self, values: Values) -> None:
        """Count a block of measured values; what their mapping costs counts for every method."""
        values = Values(values.f, values.cosines)
        start = time.perf_counter()
        predicted = evaluate(self.combinations, values, clip=False)
        self.seconds += time.perf_counter() - start
        self.negative += int(np.count_nonzero(predicted < 0))
        if self.is_clipped:
            np.maximum(predicted, 0.0, out=predicted)
        predicted -= values.f
        per_pair = np.einsum("npb,npb->np", predicted, predicted)
        self.squared += per_pair.sum(axis=1)
        self.weighted += per_pair @ values.cosines**2


def _tabulated_blocks(data: Data) -> Iterator[Values]:
    """What methods have learned from, block by block."""
    size = _block_pairs(data.n_materials, len(data.bands))
    for start in range(0, data.f.shape[1], size):
        yield Values(data.f[:, start : start + size], data.cosines[start : start + size])


def _blocks(
    materials: Sequence[MeasuredBRDF], bands: Array, grid: RusinkiewiczGrid, on_progress: Progress | None
) -> Iterator[Values]:
    """Measured values on a grid in some bands, block by block."""
    sampled = [material.select_bands(bands.tolist()) for material in materials]
    size = _block_pairs(len(materials), len(bands))
    total = -(-grid.n_pairs // size)
    for done, (wi, wo, f) in enumerate(gram.value_blocks(sampled, grid, size), start=1):
        yield Values(f, cosine_weight(wi, wo))
        if on_progress is not None:
            on_progress(done, total, "direction pairs")


def _block_pairs(n_materials: int, n_bands: int) -> int:
    return int(np.clip(_BLOCK_VALUES // (n_materials * n_bands), 64, 16384))


def _evaluate(
    model: Manifold,
    materials: Sequence[MeasuredBRDF],
    data: Data,
    encoded: Sequence[Encoded],
    blocks: Iterable[Values],
    bands: Array,
    n_pairs: int,
) -> tuple[MethodResult, ...]:
    """Errors of all methods in one walk over blocks, so that every material is evaluated once per pair."""
    errors = [_Errors(each, bands) for each in encoded]
    norm, n_values = np.zeros(len(materials)), 0
    for values in blocks:
        norm += np.einsum("npb,npb->np", values.f, values.f) @ values.cosines**2
        n_values += values.f.size
        for sums in errors:
            sums.add(values)
    physical = _plausibilities(materials, data.bands, encoded)
    colours = _colours(model, materials, encoded)
    # Eq. 22 sums over bands: those measured stand for all.
    n_counted = n_pairs * len(bands) / model.bands.count
    return tuple(
        _result(model, sums, norm, n_values, n_counted, plausible, colour)
        for sums, plausible, colour in zip(errors, physical, colours, strict=True)
    )


def _result(
    model: Manifold,
    sums: _Errors,
    norm: Array,
    n_values: int,
    n_counted: float,
    physical: Sequence[Plausibility],
    colour: tuple[ColourResult, ...],
) -> MethodResult:
    encoded = sums.encoded
    method, z = encoded.method, encoded.standardised_errors
    relative = norm_ratio(sums.weighted, norm)
    negative = sums.negative / n_values
    return MethodResult(
        key=method.key,
        title=method.title,
        is_held_out=method.is_held_out,
        numbers=method.numbers(model.bands.count),
        bytes=_bytes(model, method),
        fit_seconds=encoded.fit_seconds,
        encode_seconds=encoded.encode_seconds,
        predict_seconds=sums.seconds / len(model.names),
        rmse=_floats(np.sqrt(sums.squared / n_counted)),
        relative_error=_floats(relative),
        median_relative_error=float(np.median(relative)),
        p90_relative_error=float(np.percentile(relative, 90)),
        negative_share=0.0 if sums.is_clipped else negative,
        clipped_share=negative if sums.is_clipped else 0.0,
        reciprocity_error=max(p.reciprocity_error for p in physical),
        max_albedo=max(p.max_albedo for p in physical),
        colour=colour,
        standardised_error=None if z is None else _floats(z),
        rms_standardised_error=None if z is None else float(np.sqrt(np.mean(z**2))),
    )


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _bytes(model: Manifold, method: Method) -> int:
    """What predictions of a library need: its files, or their warps and sample bands; and numbers per material."""
    n_bands = model.bands.count
    unused = 1.0 - min(method.sample_bands or n_bands, n_bands) / n_bands
    total = _BYTES_PER_NUMBER * method.numbers(n_bands) * len(model.names)
    for name in model.names:
        info = model.library.attributes(name)
        total += info.bytes - round(unused * 4 * int(np.prod(info.shape)))
    return total


def _plausibilities(
    materials: Sequence[MeasuredBRDF], bands: Array, encoded: Sequence[Encoded]
) -> list[list[Plausibility]]:
    """Of all predictions, method by method, in some bands."""
    sampled = [material.select_bands(bands.tolist()) for material in materials]
    combinations = [[c.in_bands(bands) for c in each.combinations] for each in encoded]

    def predict(wi: Array, wo: Array) -> Array:
        values = Values(np.stack([m.eval(wi, wo) for m in sampled]), cosine_weight(wi, wo))
        return np.concatenate([evaluate(each, values) for each in combinations])

    found = plausibilities(predict, all(material.is_isotropic for material in materials))
    return [found[k : k + len(materials)] for k in range(0, len(found), len(materials))]


def _colours(
    model: Manifold, materials: Sequence[MeasuredBRDF], encoded: Sequence[Encoded]
) -> list[tuple[ColourResult, ...]]:
    """Colour errors of all predictions, method by method."""
    wi, wo = multi_angle_pairs()
    values = Values(np.stack([m.eval(wi, wo) for m in materials]), cosine_weight(wi, wo))
    results = []
    for each in encoded:
        predicted = evaluate(each.combinations, values)
        rows = []
        for illuminant in illuminants_for(model.bands):
            delta_e, angle = (
                e.mean(axis=1) for e in colour_differences(values.f, predicted, model.bands, illuminant)
            )
            rows.append(
                ColourResult(
                    illuminant, _floats(delta_e), float(np.median(delta_e)), _floats(angle),
                    float(np.median(angle)),
                )
            )  # fmt: skip
        results.append(tuple(rows))
    return results


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
