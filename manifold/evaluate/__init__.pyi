from .chart import Chart, make_chart
from .pipeline import embed
from .reading_curve import Curve, measure_curves
from .report import Report, make_report
from .report_text import format_report

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
