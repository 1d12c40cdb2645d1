from .curve import Curve, measure_curves

__all__ = ["Curve", "measure_curves"]
