from .chart import Chart, make_chart
from .readings import Curve, measure_curves
from .report import Report, make_report
from .report_text import format_report
from .selection import embed

__all__ = [
    "Chart",
    "Curve",
    "Report",
    "embed",
    "format_report",
    "make_chart",
    "make_report",
    "measure_curves",
]
