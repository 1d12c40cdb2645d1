from .experiment import Chart, make_chart

__all__ = ["Chart", "make_chart"]
