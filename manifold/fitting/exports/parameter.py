"""Parameters of targets' models, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Parameter:
    """A parameter of a target's model.

    Attributes:
        default: of the target; a list of three for a colour.
        is_free: whether a direct fit changes it.
        low, high: the range of direct fits.
    """

    default: Any
    is_free: bool = False
    low: float = 0.0
    high: float = 1.0

    @property
    def is_share(self) -> bool:
        """Whether it ranges from 0 to 1, where a fit that comes near an end means that end."""
        return (self.low, self.high) == (0.0, 1.0)


def defaults(parameters: Mapping[str, Parameter]) -> dict[str, Any]:
    """The target's value of every parameter that is not set."""
    return {name: parameter.default for name, parameter in parameters.items()}
