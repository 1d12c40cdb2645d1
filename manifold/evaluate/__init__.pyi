from .chart import make_chart
from .report import make_report

__all__ = [
    "make_chart",
    "make_report",
]
