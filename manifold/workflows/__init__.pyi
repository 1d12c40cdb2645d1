from . import (
    ball_pictures,
    budgets,
    demo,
    fit_pictures,
    fits,
    inspection,
    pictures,
    pipeline,
    renders,
)
from .prediction import predict
from .reconstruction import locate, reconstruct

__all__ = [
    "ball_pictures",
    "budgets",
    "demo",
    "fit_pictures",
    "fits",
    "inspection",
    "locate",
    "pictures",
    "pipeline",
    "predict",
    "reconstruct",
    "renders",
]
