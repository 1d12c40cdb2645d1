"""Measures times relative to a reference."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from manifold.analytic import corpus
from manifold.brdf.measured import MeasuredBRDF
from manifold.core.pairs import Pairs, RusinkiewiczGrid
from manifold.core.records import Array
from manifold.core.threads import limit_threads

REFERENCE = "syn_satin_gold"
REFERENCE_PAIRS = 8192

Made = TypeVar("Made")


@dataclass(frozen=True)
class RelativeTime:
    """A time relative to the reference: the median of repeated runs, and their interquartile range."""

    median: float
    spread: float

    @classmethod
    def of(cls, ratios: Sequence[float] | Array) -> RelativeTime:
        """Summarise repeated runs."""
        low, median, high = np.percentile(ratios, [25, 50, 75])
        return cls(float(median), float(high - low))

    @classmethod
    def of_several(cls, runs: Sequence[Array]) -> RelativeTime:
        """Summarise repeated runs of several tasks: the median over all, and the spread of runs.

        The spread of each task's runs is relative to the task's own median.
        """
        medians = np.array([np.median(ratios) for ratios in runs])
        apart = np.concatenate([ratios / m for ratios, m in zip(runs, medians, strict=True)])
        median = float(np.median(medians))
        return cls(median, median * cls.of(apart).spread)


class Stopwatch:
    """Measures processor times relative to a reference that runs just before, which removes effects of the machine.

    The reference is one evaluation of a synthetic material in 195 bands at 8192 direction pairs.
    """

    def __init__(self) -> None:
        """Measure the reference material, which is the same everywhere."""
        (material,) = (m for m in corpus.isotropic_materials() if m.name == REFERENCE)
        self._brdf = MeasuredBRDF(corpus.measure(material))
        self._pairs = some_pairs(REFERENCE_PAIRS)
        self._runs: list[float] = []
        self.lap(lambda: None)  # the first run fills caches
        self._runs.clear()

    def lap(self, work: Callable[[], Made]) -> tuple[Made, float]:
        """Run a function; return its result, and its time relative to the reference."""
        start = time.process_time()
        self._brdf.eval_at(self._pairs)
        middle = time.process_time()
        result = work()
        end = time.process_time()
        self._runs.append(middle - start)
        return result, (end - middle) / (middle - start)

    def laps(self, work: Callable[[], object], count: int) -> Array:
        """Return the relative times of `count` runs of a function, after one run that is not measured."""
        work()
        return np.array([self.lap(work)[1] for _ in range(count)])

    @property
    def reference_seconds(self) -> float:
        """Median processor time of the reference."""
        return float(np.median(self._runs))


@contextmanager
def one_core() -> Iterator[None]:
    """Run compiled loops and BLAS on one core inside the block, which makes times less dependent on other processes."""
    with limit_threads(1), threadpool_limits(1):
        yield


def some_pairs(count: int, grid: RusinkiewiczGrid | None = None) -> Pairs:
    """Return direction pairs above the horizon, spread evenly over a grid, by default 45 x 23 x 12."""
    pairs = (grid or RusinkiewiczGrid.named("default")).pairs()
    return pairs[np.linspace(0, len(pairs) - 1, count).astype(int)]
