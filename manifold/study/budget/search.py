"""Searches the cheapest representation of every material of a scene that preserves its picture.

A callback renders and returns the differences. Candidates are tried from the cheapest on; candidates whose predicted
difference is far above the tolerance are not rendered. First each material is replaced alone, then all together. If
all together differ too much, the search is repeated with the tolerance divided by the square root of 2. Halving the
tolerance never gives a cheaper result, because the sequence of divided tolerances for the larger one contains that
for the smaller one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from manifold.core.errors import UsageError
from manifold.study.budget.representations import Representation

SLACK = 2.0
"""Candidates are rendered if their predicted difference is at most this many times the tolerance."""

_STEP = 2.0**-0.5
_MOST_STEPS = 16


@dataclass(frozen=True)
class Difference:
    """Mean differences over the pixels that show a material.

    Attributes:
        delta_e: CIEDE2000 without the contribution of noise.
        rendered: CIEDE2000 as rendered.
        flip: FLIP as rendered.
    """

    delta_e: float
    rendered: float
    flip: float


@dataclass(frozen=True)
class Tolerance:
    """The largest allowed differences of a picture, and limits on size and time.

    Attributes:
        delta_e: limit of the mean CIEDE2000.
        flip: limit of the mean FLIP; None for no limit.
        size: limit of the bytes of all materials together; None for no limit.
        milliseconds: time of a million evaluations of a material; None for no limit.
    """

    delta_e: float = 1.0
    flip: float | None = None
    size: int | None = None
    milliseconds: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not value > 0:
                raise UsageError(
                    f"tolerance of {name.replace('_', ' ')}: found {value:g}, expected a number above 0"
                )

    def admits(self, found: Difference, scale: float = 1.0) -> bool:
        """Return whether a difference is within the tolerance times a scale."""
        return found.delta_e <= scale * self.delta_e and (
            self.flip is None or found.flip <= scale * self.flip
        )


Choice = Mapping[str, Representation]
"""The chosen candidate of each material, by key; missing materials keep the reference."""

Verify = Callable[[Choice], Mapping[str, Difference]]
"""A function that renders a choice and returns its measured differences, per material."""


@dataclass(frozen=True)
class Answer:
    """The result of a search: the choice and its differences.

    Attributes:
        choice: the chosen candidate of every material.
        together: differences per material with all chosen candidates.
        alone: differences of all candidates that were rendered alone, by material and the candidate's name.
    """

    choice: Mapping[str, Representation]
    together: Mapping[str, Difference]
    alone: Mapping[str, Mapping[str, Difference]]


def search(
    candidates: Mapping[str, Sequence[Representation]],
    tolerance: Tolerance,
    verify: Verify,
    milliseconds: Callable[[Representation], float] | None = None,
    others: int = 0,
) -> Answer:
    """Find the cheapest choice within a tolerance.

    The candidates of a material are sorted from the cheapest on and include the whole file
    (`Representation.is_full`). `verify` renders a choice, and is called once per choice. Times of candidates are
    needed only if the tolerance limits them. If the tolerance limits bytes, `others`, the bytes of unchanged
    materials, are included.
    """
    alone: dict[str, dict[str, Difference]] = {key: {} for key in candidates}

    def difference_alone(key: str, candidate: Representation) -> Difference:
        known = alone[key]
        if candidate.name not in known:
            known[candidate.name] = verify({key: candidate})[key]
        return known[candidate.name]

    most = tolerance.milliseconds
    quick = {
        key: [c for c in one if most is None or milliseconds is None or milliseconds(c) <= most]
        for key, one in candidates.items()
    }
    seen: dict[tuple[str, ...], Mapping[str, Difference]] = {}
    for step in range(_MOST_STEPS):
        scale = _STEP**step
        choice = {key: _first(key, one, tolerance, scale, difference_alone) for key, one in quick.items()}
        names = tuple(candidate.name for candidate in choice.values())
        if names not in seen:
            # One material together with none is what it is alone.
            seen[names] = (
                verify(choice) if len(choice) > 1 else {k: difference_alone(k, c) for k, c in choice.items()}
            )
        if all(tolerance.admits(found) for found in seen[names].values()):
            total = others + sum(candidate.size for candidate in choice.values())
            if tolerance.size is not None and total > tolerance.size:
                raise UsageError(
                    f"a CIEDE2000 of {tolerance.delta_e:g} in the scene's light needs {total} bytes, expected at "
                    f"most {tolerance.size}; raise either limit"
                )
            return Answer(choice, seen[names], alone)
    raise UsageError(
        f"no combination meets a CIEDE2000 of {tolerance.delta_e:g} in the scene's light with all materials together; "
        "raise the tolerance"
    )


def _first(
    key: str, candidates: Sequence[Representation], tolerance: Tolerance, scale: float,
    difference_alone: Callable[[str, Representation], Difference],
) -> Representation:  # fmt: skip
    """Return the cheapest candidate within the scaled tolerance."""
    for candidate in candidates:
        if candidate.predicted <= SLACK * scale * tolerance.delta_e and tolerance.admits(
            difference_alone(key, candidate), scale
        ):
            return candidate
    if not candidates:
        raise UsageError(
            f"no representation is evaluated a million times within {tolerance.milliseconds:g} ms; raise the limit"
        )
    best = min(candidates, key=lambda candidate: candidate.predicted)
    found = difference_alone(key, best)
    raise UsageError(
        f"no representation within {tolerance.milliseconds or 0:g} ms meets a CIEDE2000 of "
        f"{scale * tolerance.delta_e:.3g} in the scene's light; closest is '{best.name}' with "
        f"{found.delta_e:.3g}; raise either limit"
    )
