"""Measures the coherence of a map: whether predictions between two similar materials look like both of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from manifold.colour import panel
from manifold.colour.conversion import srgb_to_xyz
from manifold.colour.difference import VISIBLE, delta_e_2000_lab, to_lab
from manifold.core import progress
from manifold.core.names import percent
from manifold.core.records import Array, Indices, evenly_spaced

NEIGHBOURS_COMPARED = 5
"""Number of most similar materials that should be nearest on the map."""

FAR = 1.5
"""Detour above which a prediction does not lie between its two materials."""

LOST = 0.25
"""Share of kept neighbours below which predictions between materials should not be trusted."""

_MEASURED = 200  # materials from which detours are measured, at most
_PIXELS = 8  # every so many serve to find the most similar materials


@dataclass(frozen=True)
class Pair:
    """The indices of a material and of the material that looks most like it.

    Attributes:
        difference: mean CIEDE2000 between their balls, over the five test lights.
        detour: for the prediction halfway between the materials, the sum of its differences from each of them, divided
            by `difference`; 1 if the prediction lies exactly in between.
    """

    first: int
    second: int
    difference: float
    detour: float


@dataclass(frozen=True)
class Coherence:
    """How well a map keeps similar materials together.

    Attributes:
        detour, detour_p90: median and 90th percentile of `Pair.detour` over the materials; 1 is ideal.
        detour_far: share of the materials with a detour above 1.5.
        neighbours_kept: share of the five most similar materials that are among the five nearest on the map.
    """

    detour: float
    detour_p90: float
    detour_far: float
    neighbours_kept: float

    @classmethod
    def from_statistics(cls, statistics: dict[str, float]) -> Coherence | None:
        """Restore the measures from the statistics of a fit; None if they are not among the statistics."""
        try:
            return cls(*(statistics[name] for name in cls.__dataclass_fields__))
        except KeyError:
            return None

    @property
    def statistics(self) -> dict[str, float]:
        """Return the measures by name, as the model file stores them."""
        return asdict(self)

    @property
    def words(self) -> tuple[str, str]:
        """Return the detour and the kept neighbours, each as a line of text."""
        return (
            f"{self.detour:.2f}, 90th percentile {self.detour_p90:.2f} (1: the prediction halfway to the most similar "
            f"material lies between the two), above {FAR} for {percent(self.detour_far)} of the materials",
            f"{percent(self.neighbours_kept)} of the {NEIGHBOURS_COMPARED} most similar materials are among the "
            f"{NEIGHBOURS_COMPARED} nearest",
        )

    @property
    def warning(self) -> str | None:
        """Return a diagnostic if the map separates most similar materials, otherwise None."""
        if self.neighbours_kept >= LOST:
            return None
        return (
            f"the map keeps {percent(self.neighbours_kept)} of the most similar materials together, expected at least "
            f"{percent(LOST)}: predict in a given colour, or embed in more dimensions"
        )


def measure_coherence(
    X: Array, ball: Callable[[int], Array], predict: Callable[[Array], Array]
) -> tuple[Coherence | None, list[Pair]]:
    """Return the coherence of a map of N materials at latents X (N, Q), and its pairs of similar materials.

    `ball` returns the CIE XYZ values (K, 3) of a material's ball in the five test lights, and `predict`
    returns them for the prediction at a latent (Q,). The coherence is None if all materials look alike.
    """
    lights, pairs, kept = panel.judged(), list[Pair](), list[float]()
    count = min(NEIGHBOURS_COMPARED, len(X) - 1)
    some = progress.each(evenly_spaced(len(X), _MEASURED).tolist(), "points between materials")
    for i, similar in most_similar(ball, len(X), count, some):
        near = _others(np.argsort(np.sum((X - X[i]) ** 2, axis=1), kind="stable"), i)[:count]
        kept.append(len(np.intersect1d(similar, near)) / count)
        j = int(similar[0])
        ends = ball(i), ball(j)
        difference = lights.compare(*ends).ball
        if difference >= VISIBLE:
            between = predict(0.5 * (X[i] + X[j]))
            way = sum(lights.compare(end, between).ball for end in ends)
            pairs.append(Pair(i, j, difference, way / difference))
    if not pairs:
        return None, []
    detours = np.array([pair.detour for pair in pairs])
    found = Coherence(
        float(np.median(detours)), float(np.quantile(detours, 0.9)), float(np.mean(detours > FAR)),
        float(np.mean(kept)),
    )  # fmt: skip
    return found, pairs


def most_similar(
    ball: Callable[[int], Array], of: int, count: int, materials: Iterable[int]
) -> Iterator[tuple[int, Indices]]:
    """Yield each of `materials` with the `count` most similar ones of all `of` materials, most similar first.

    `ball` returns the CIE XYZ values (K, 3) of a material's ball in the five test lights.
    """
    white, (some, chosen) = srgb_to_xyz(np.ones(3)), panel.judged().every(_PIXELS)
    lab = np.stack([to_lab(xyz[chosen], white).astype(np.float32) for xyz in map(ball, range(of))])
    for i in materials:
        apart = delta_e_2000_lab(lab, lab[i]) @ some.pixel_weights / len(chosen)
        yield i, _others(np.argsort(apart, kind="stable"), i)[:count]


def _others(materials: Indices, i: int) -> Indices:
    return materials[materials != i]


def typical_pair(pairs: Sequence[Pair]) -> Pair:
    """Return, of all pairs that are mutually most similar, the pair with the median difference."""
    both = {(pair.first, pair.second) for pair in pairs}
    mutual = [p for p in pairs if p.first < p.second and (p.second, p.first) in both]
    ordered = sorted(mutual or pairs, key=lambda pair: (pair.difference, pair.first))
    return ordered[len(ordered) // 2]
