"""The five test lights in which errors are measured, and texts that name these errors."""

from manifold.core.names import in_words

JUDGED = ("studio 0", "white", "sun 45", "sun 80", "sun 130")
"""The test lights, in which errors are measured. Balls are fitted in others; see `colour.panel`."""


def light_in_words(name: str) -> str:
    """Return a text for a light of `JUDGED`, such as a sun with its angle."""
    kind, _, angle = name.partition(" ")
    return f"sun {angle} degrees from the view" if kind == "sun" else name


LIGHTS = f"{in_words(len(JUDGED))} lights"
"""Text with the number of these lights, `five lights`."""

BALL = f"CIEDE2000 of the ball (mean of {LIGHTS})"
"""Text for the error `Errors.ball`."""

BALL_COLUMN = f"CIEDE2000 ({LIGHTS})"
"""Column heading for the error `Errors.ball`."""
