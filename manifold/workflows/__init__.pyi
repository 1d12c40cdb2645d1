from . import (
    ball_pictures,
    budgets,
    charts,
    demo,
    failures,
    fit_pictures,
    fits,
    inspection,
    pictures,
    pipeline,
    renders,
)
from .renders import render_ball

__all__ = [
    "ball_pictures",
    "budgets",
    "charts",
    "demo",
    "failures",
    "fit_pictures",
    "fits",
    "inspection",
    "pictures",
    "pipeline",
    "render_ball",
    "renders",
]
