"""Measures of a report besides errors: multi-angle colour, plausibility, bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.pairs import DirectionPairs
from manifold.brdf.plausibility import Plausibility, plausibilities
from manifold.colour.difference import colour_differences, illuminants_for, multi_angle_pairs
from manifold.experiments.evaluation.method import Method
from manifold.experiments.evaluation.tabulated import Data
from manifold.library.store import Library
from manifold.metrics import RusinkiewiczGrid
from manifold.model import gram
from manifold.model.combination import Combination, Values, evaluate
from manifold.records import Array, Progress

_BLOCK_VALUES = 10_000_000  # measured values held at once, of all materials together
_BYTES_PER_NUMBER = 8

Predictions = Sequence[Sequence[Combination]]
"""Per method, one per material."""


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


def colour_results(
    materials: Sequence[MeasuredBRDF], predictions: Predictions
) -> list[tuple[ColourResult, ...]]:
    """Colour errors of all predictions, method by method, illuminant by illuminant."""
    values, bands = Values.at(materials, DirectionPairs(*multi_angle_pairs())), materials[0].bands
    results = []
    for each in predictions:
        predicted = evaluate(each, values)
        rows = []
        for illuminant in illuminants_for(bands):
            delta_e, angle = (
                e.mean(axis=1) for e in colour_differences(values.f, predicted, bands, illuminant)
            )
            rows.append(
                ColourResult(
                    illuminant, tuple(delta_e.tolist()), float(np.nanmedian(delta_e)), tuple(angle.tolist()),
                    float(np.nanmedian(angle)),
                )
            )  # fmt: skip
        results.append(tuple(rows))
    return results


def plausibility_results(
    materials: Sequence[MeasuredBRDF], bands: Array, predictions: Predictions
) -> list[list[Plausibility]]:
    """Of all predictions, method by method, in some bands."""
    selected = [material.select_bands(bands.tolist()) for material in materials]
    here = [[c.in_bands(bands) for c in each] for each in predictions]

    def predict(wi: Array, wo: Array) -> Array:
        values = Values.at(selected, DirectionPairs(wi, wo))
        return np.concatenate([evaluate(each, values) for each in here])

    found = plausibilities(predict, all(material.is_isotropic for material in materials))
    return [found[k : k + len(materials)] for k in range(0, len(found), len(materials))]


def needed_bytes(library: Library, names: Sequence[str], method: Method) -> int:
    """Bytes needed to predict: files, or their warps and sample bands, and the numbers of all materials."""
    n_bands = library.bands.count
    unused = 1.0 - min(method.sample_bands or n_bands, n_bands) / n_bands
    total = _BYTES_PER_NUMBER * method.numbers(n_bands) * len(names)
    for name in names:
        info = library.attributes(name)
        total += info.bytes - round(unused * 4 * int(np.prod(info.shape)))
    return total


def tabulated_blocks(data: Data) -> Iterator[Values]:
    """The tabulated values, block by block."""
    size = _block_pairs(data.n_materials, len(data.bands))
    for start in range(0, data.f.shape[1], size):
        some = slice(start, start + size)
        yield Values(data.f[:, some], data.wi[some], data.wo[some])


def measured_blocks(
    materials: Sequence[MeasuredBRDF], bands: Array, grid: RusinkiewiczGrid, on_progress: Progress | None
) -> Iterator[Values]:
    """Measured values on a grid in some bands, block by block."""
    selected = [material.select_bands(bands.tolist()) for material in materials]
    size = _block_pairs(len(materials), len(bands))
    total = -(-grid.n_pairs // size)
    for done, (wi, wo, f) in enumerate(gram.value_blocks(selected, grid, size), start=1):
        yield Values(f, wi, wo)
        if on_progress is not None:
            on_progress(done, total, "direction pairs")


def _block_pairs(n_materials: int, n_bands: int) -> int:
    return int(np.clip(_BLOCK_VALUES // (n_materials * n_bands), 64, 16384))
