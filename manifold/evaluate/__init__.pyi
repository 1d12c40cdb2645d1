from .report import make_report
from .selection import embed

__all__ = [
    "embed",
    "make_report",
]
