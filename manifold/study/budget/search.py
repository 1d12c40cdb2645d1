"""The cheapest representation of every material of a scene that preserves its image: the search.

Rendering is a callback: the search is given the differences that a render shows. Candidates are tried cheapest first;
those whose predicted difference is far beyond the tolerance are not rendered. Each material is compared alone first,
the others being the reference, then all together; where together they differ too much, all start again with a
tolerance smaller by the square root of 2. Because of that grid, half the tolerance never gives a cheaper answer:
whatever passes a small tolerance passes a larger one, and the larger tolerance's grid holds all steps of the smaller
one's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from manifold.core.errors import UsageError
from manifold.study.budget.representations import Representation

SLACK = 2.0
"""Candidates are rendered where their predicted difference is at most this many times the tolerance."""

_STEP = 2.0**-0.5
_MOST_STEPS = 16


@dataclass(frozen=True)
class Difference:
    """Means over the pixels that show a material.

    Attributes:
        delta_e: CIEDE2000, the share of noise taken out.
        rendered: CIEDE2000 as rendered.
        flip: FLIP as rendered.
    """

    delta_e: float
    rendered: float
    flip: float


@dataclass(frozen=True)
class Tolerance:
    """The most that a picture may differ.

    Attributes:
        delta_e: mean CIEDE2000.
        flip: mean FLIP; None for any.
        size: bytes of all materials together; None for any.
        milliseconds: for a million evaluations of a material; None for any.
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
"""A candidate per material, by key; a material that is missing is the reference."""

Verify = Callable[[Choice], Mapping[str, Difference]]
"""The measured error of a render with a choice of representations, per material."""


@dataclass(frozen=True)
class Answer:
    """The result of a search.

    Attributes:
        choice: a candidate for every material.
        together: how the picture differs with all of them, per material.
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

    Candidates of each material are sorted, cheapest first; the last resort, `Representation.is_full`, is among them.
    `verify` renders a choice, and is called once for each. Times of candidates are needed where the tolerance limits
    them; where it limits bytes, those of `others`, which stay as they are, count.
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
            f"no representation evaluates a million times within {tolerance.milliseconds:g} ms; allow more"
        )
    best = min(candidates, key=lambda candidate: candidate.predicted)
    found = difference_alone(key, best)
    raise UsageError(
        f"no representation within {tolerance.milliseconds or 0:g} ms meets a CIEDE2000 of "
        f"{scale * tolerance.delta_e:.3g} in the scene's light; closest is '{best.name}' with "
        f"{found.delta_e:.2f}; raise either limit"
    )
