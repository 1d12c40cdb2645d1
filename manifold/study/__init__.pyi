from .chart import make_chart

__all__ = [
    "make_chart",
]
