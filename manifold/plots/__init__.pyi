from .plot_balls import ball_map, walk_strip
from .plot_budget import budget_figure
from .plot_chart import chart
from .plot_comparison import comparison
from .plot_fit import fit_picture
from .plot_latents import latent_map
from .plot_slices import Source, angle_slices, rusinkiewicz_images, spectra_at
from .plot_stability import panels

__all__ = [
    "Source",
    "angle_slices",
    "ball_map",
    "budget_figure",
    "chart",
    "comparison",
    "fit_picture",
    "latent_map",
    "panels",
    "rusinkiewicz_images",
    "spectra_at",
    "walk_strip",
]
