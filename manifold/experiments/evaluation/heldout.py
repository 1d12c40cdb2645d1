"""Encode-decode leave-one-out: how well methods predict a material they were fitted without.

Every method is fitted to N - 1 materials, finds the latent of the left-out one from its data, and decodes
it; the error is `||w (f* - f)|| / ||w f||` with `w = cos(theta_i) cos(theta_o)`. Latents that were fitted with the
left-out material, or the reconstruction of training data, would flatter.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from manifold.brdf.measured import BRDF
from manifold.errors import ShapeError
from manifold.experiments.evaluation.methods import Method, standard_methods
from manifold.experiments.evaluation.tabulated import Data
from manifold.metrics import RusinkiewiczGrid
from manifold.model.combination import Combination
from manifold.parallel import one_blas_thread
from manifold.records import Array, Progress

__all__ = ["Data", "Encoded", "Method", "Result", "compare", "encode_all", "standard_methods"]


@dataclass(frozen=True, eq=False)
class Encoded:
    """What a method makes of every material.

    Attributes:
        method: the method.
        combinations: one per material.
        standardised_errors: z of the mapped values per material, shape (N,); None where the method gives no
            variance. See `standardised_error`.
        fit_seconds: wall-clock time of one fit.
        encode_seconds: wall-clock time of encoding one material, once fitted.
    """

    method: Method
    combinations: tuple[Combination, ...]
    standardised_errors: Array | None
    fit_seconds: float
    encode_seconds: float


@dataclass(frozen=True)
class Result:
    """Errors of one method over all materials.

    Attributes:
        key, title: of the method.
        numbers: that describe a material.
        relative_error: per material.
        median, p90: of them.
        negative_share: of all predicted values.
        seconds: for all materials, wall-clock.
    """

    key: str
    title: str
    numbers: int
    relative_error: tuple[float, ...]
    median: float
    p90: float
    negative_share: float
    seconds: float


def encode_all(data: Data, method: Method, on_material: Callable[[int], None] | None = None) -> Encoded:
    """Encode every material: left out of the fit if the method refits, else all by one fit.

    `on_material` is called with the number of materials done.
    """
    everything = np.arange(data.n_materials)
    combinations, fits = [], []
    encode_seconds = 0.0
    encode = None
    for i in range(data.n_materials):
        with one_blas_thread:  # the matrices are small: a second thread costs more than it does
            if encode is None or method.refits:
                start = time.perf_counter()
                try:
                    encode = method.fit(data, np.delete(everything, i) if method.refits else everything)
                except ShapeError as error:
                    left = f" without material {i + 1}" * method.refits
                    raise ShapeError(
                        f"{method.title},{left} of {data.n_materials}: {error}; import more that differ"
                    ) from error
                fits.append(time.perf_counter() - start)
            start = time.perf_counter()
            combinations.append(encode(i))
            encode_seconds += time.perf_counter() - start
        if on_material is not None:
            on_material(i + 1)
    z = None
    if method.is_held_out and all(c.variance is not None for c in combinations):
        z = np.array([standardised_error(data, i, c) for i, c in enumerate(combinations)])
    return Encoded(method, tuple(combinations), z, float(np.mean(fits)), encode_seconds / data.n_materials)


def standardised_error(data: Data, i: int, combination: Combination) -> float:
    """Error of the mapped prediction of material i, in the standard deviations that the method expected.

    `z = sqrt(sum w (T(f) - T(f*))^2 / (P sum_b variance_b))` over pairs and the data's bands, with the weight
    `w = cos(theta_i) cos(theta_o)` that outputs have in the Gram matrix. Calibrated methods have a root mean
    square of z near 1.
    """
    here = combination.in_bands(data.bands)
    wrong = here.mapped(data) - data.mapped(combination.mapping)[i]  # [P, B']
    squared = float(np.sum(data.cosines[:, None] * wrong**2))
    assert here.variance is not None
    expected = float(np.mean(here.variance)) * wrong.size
    if expected <= 0.0:  # a method that is sure: of a training latent, say
        return 0.0 if squared == 0.0 else float("inf")
    return float(np.sqrt(squared / expected))


def compare(
    materials: Sequence[BRDF],
    methods: Sequence[Method] | None = None,
    grid: RusinkiewiczGrid | None = None,
    on_progress: Progress | None = None,
) -> list[Result]:
    """Leave every material out once with every method; errors in at most 20 bands.

    Args:
        materials: at least four, of the same bands.
        methods: by default `standard_methods()`.
        grid: direction pairs; by default the 45 x 23 x 12 Rusinkiewicz grid.
        on_progress: called with (done, total, title).
    """
    data = Data.evaluate(materials, RusinkiewiczGrid.named("default") if grid is None else grid)
    methods = standard_methods() if methods is None else methods
    results = []
    total = len(methods) * len(materials)
    for m, method in enumerate(methods):

        def step(done: int, before: int = m * len(materials), title: str = method.title) -> None:
            if on_progress is not None:
                on_progress(before + done, total, title)

        start = time.perf_counter()
        encoded = encode_all(data, method, step)
        errors, negative = [], 0.0
        for i, combination in enumerate(encoded.combinations):
            predicted = combination.in_bands(data.bands).evaluate(data)
            errors.append(data.relative_error(i, predicted))
            negative += float(np.mean(predicted < 0)) / len(materials)
        results.append(
            Result(
                key=method.key,
                title=method.title,
                numbers=method.numbers(data.n_bands),
                relative_error=tuple(errors),
                median=float(np.median(errors)),
                p90=float(np.percentile(errors, 90)),
                negative_share=negative,
                seconds=time.perf_counter() - start,
            )
        )
    return results
