"""Limits that several failure modes share, each with its reason."""

from __future__ import annotations

from manifold.experiments.stability.trials import Limit

HALF_OF_NEAREST = Limit(
    "error of a held-out plastic, as a share of the nearest material's",
    0.5,
    "a manifold that does not halve the error of the nearest material is not worth its fit",
)
BALL = Limit(
    "CIEDE2000 of the ball beside the truth's, lit from behind",
    5.0,
    "an observer sees two different colours (Mokrzycki & Tatol 2011); chosen after the results were known",
)
SAME_RESULT = Limit(
    "relative difference of the prediction",
    0.01,
    "instruments repeat themselves no better",
)
NONE_TAKEN = Limit("files taken that must not be", 0.0, "one is one too many")
