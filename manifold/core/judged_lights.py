"""The lights in which errors are measured, and words for these errors, which helps name without loading numbers."""

from manifold.core.names import in_words

JUDGED = ("studio 0", "white", "sun 45", "sun 80", "sun 130")
"""The lights in which errors are measured, and which no fit uses: studio, uniform light, suns; see `colour.panel`."""


def light_in_words(name: str) -> str:
    """Return a light of `JUDGED` in words: a sun with its angle."""
    kind, _, angle = name.partition(" ")
    return f"sun {angle} degrees from the view" if kind == "sun" else name


LIGHTS = f"{in_words(len(JUDGED))} lights"
"""The number of these lights, in words."""

BALL = f"CIEDE2000 of the ball (mean of {LIGHTS})"
"""In words, the error `Errors.ball`."""

BALL_COLUMN = f"CIEDE2000 ({LIGHTS})"
"""The error `Errors.ball` at the head of a column."""
