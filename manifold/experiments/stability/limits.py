"""Limits that several failure modes share, each with its reason."""

from __future__ import annotations

from manifold.experiments.stability.trials import Limit

HALF_OF_NEAREST = Limit(
    "error of a held-out plastic, relative to that of the nearest material",
    0.5,
    "a manifold should at least halve the error of the nearest material",
)
BALL = Limit(
    "CIEDE2000 between the balls of prediction and ground truth, lit from behind",
    5.0,
    "an observer sees two different colours (Mokrzycki & Tatol 2011); chosen after the results were known",
)
SAME_RESULT = Limit(
    "relative difference of the prediction",
    0.01,
    "the repeatability of instruments is no better",
)
NONE_TAKEN = Limit("invalid files that were accepted", 0.0, "none may be accepted")
