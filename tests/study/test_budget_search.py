"""The search of `manifold budget`, with pictures made of numbers."""

from __future__ import annotations

import numpy as np
import pytest

from manifold.core.errors import UsageError
from manifold.study.budget.representations import FULL, Representation
from manifold.study.budget.search import Difference, Tolerance, search
from manifold.study.budget.verification import without_noise


def some_candidates(rng, n=6):
    """Candidates of growing size whose differences fall only roughly, and the whole file."""
    true = np.sort(rng.uniform(0.05, 6.0, n))[::-1] * rng.uniform(0.5, 1.5, n)
    made = [
        Representation(f"c{k}", 10 * (k + 1), {"true": d}, d * rng.uniform(0.7, 1.4))
        for k, d in enumerate(true)
    ]
    return [*made, Representation(FULL, 1000, {"true": 0.0}, 0.0)]


def difference(candidate, extra=0.0):
    value = candidate.bsdf["true"] + (0.0 if candidate.is_full else extra)
    return Difference(value, value, 0.05 * value)


def verify_with(interreflection):
    """Pictures where each exchanged material also spoils those of the others."""

    def verify(choice):
        spoiled = sum(c.bsdf["true"] for c in choice.values()) * interreflection * (len(choice) > 1)
        return {key: difference(c, spoiled) for key, c in choice.items()}

    return verify


def total(answer):
    return sum(candidate.size for candidate in answer.choice.values())


@pytest.mark.parametrize("interreflection", [0.0, 0.2, 1.0])
def test_half_the_tolerance_is_never_cheaper(rng, interreflection):
    steps = 0
    for _ in range(60):
        candidates = {key: some_candidates(rng) for key in "abc"}
        sizes = [
            total(search(candidates, Tolerance(t), verify_with(interreflection)))
            for t in (4.0, 2.0, 1.0, 0.5, 0.25)
        ]
        assert sizes == sorted(sizes)
        steps += len(set(sizes)) - 1
    assert steps > 60  # the answers do change


def test_the_answer_keeps_the_tolerance_with_all_materials_together(rng):
    verify = verify_with(0.5)
    tightened = 0
    for _ in range(60):
        candidates = {key: some_candidates(rng) for key in "ab"}
        answer = search(candidates, Tolerance(1.5), verify)
        shown = verify(answer.choice)
        assert all(found.delta_e <= 1.5 for found in shown.values())
        alone = {
            k: next(c for c in one if c.bsdf["true"] <= 1.5 and c.predicted <= 3.0)
            for k, one in candidates.items()
        }
        tightened += alone != dict(answer.choice)
    assert tightened > 0


def test_alone_the_answer_is_the_cheapest_within_the_tolerance():
    candidates = [
        Representation("rough", 1, {"true": 2.0}, 1.9),
        Representation("far", 2, {"true": 0.1}, 9.0),  # predicted far away: not rendered
        Representation("fine", 3, {"true": 0.9}, 1.1),
        Representation(FULL, 9, {"true": 0.0}, 0.0),
    ]
    answer = search({"a": candidates}, Tolerance(1.0), verify_with(0.0))
    assert answer.choice["a"].name == "fine"
    assert set(answer.alone["a"]) == {"rough", "fine"}


def test_every_picture_is_rendered_once(rng):
    rendered = []

    def verify(choice):
        rendered.append(tuple(sorted((key, c.name) for key, c in choice.items())))
        return verify_with(1.0)(choice)

    search({key: some_candidates(rng) for key in "ab"}, Tolerance(1.0), verify)
    assert len(rendered) == len(set(rendered))


def test_flip_limits_too(rng):
    candidates = {"a": some_candidates(rng)}
    free = search(candidates, Tolerance(4.0), verify_with(0.0))
    tight = search(candidates, Tolerance(4.0, flip=0.001), verify_with(0.0))
    assert tight.together["a"].flip <= 0.001 < free.together["a"].flip


def test_limits_of_time_leave_slow_candidates_out(rng):
    candidates = {"a": some_candidates(rng)}
    slow = candidates["a"][-1]
    with pytest.raises(UsageError, match=r"closest is 'c\d' with .*raise either limit"):
        search(
            candidates,
            Tolerance(1e-3, milliseconds=5.0),
            verify_with(0.0),
            lambda c: 9.0 if c is slow else 1.0,
        )


def test_a_limit_of_bytes_that_cannot_be_kept_says_what_it_takes(rng):
    with pytest.raises(UsageError, match="needs 1000 bytes, expected at most 500"):
        search({"a": some_candidates(rng)}, Tolerance(1e-3, size=500), verify_with(0.0))


@pytest.mark.parametrize(
    "limits",
    [
        {"delta_e": 0.0},
        {"delta_e": -1.0},
        {"delta_e": np.nan},
        {"flip": 0.0},
        {"size": 0},
        {"milliseconds": -2},
    ],
)
def test_a_limit_that_is_not_above_zero_is_refused(limits):
    with pytest.raises(UsageError, match="expected a number above 0"):
        Tolerance(**limits)


def test_noise_is_taken_out_of_differences(rng):
    """Squared differences of two noisy pictures: truth plus noise that is inverse to the samples."""
    truth, noise, n = 0.8, 1.1, 4000
    halves = truth + noise * np.sqrt(2.0) * rng.standard_normal((2, n))
    root_mean_square = [float(np.sqrt(np.mean(d**2))) for d in (halves.mean(axis=0), *halves)]
    assert root_mean_square[0] > 1.2
    assert without_noise(root_mean_square[0], root_mean_square[1:]) == pytest.approx(
        truth, abs=0.1
    )  # n = 4000
    assert without_noise(0.0, [0.0, 0.0]) == 0.0
