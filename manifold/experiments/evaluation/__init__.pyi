from .report import Report, make_report
from .report_text import format_report

__all__ = ["Report", "format_report", "make_report"]
