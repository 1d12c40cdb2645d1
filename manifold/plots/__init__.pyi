from .ball_figures import ball_map, walk_strip
from .map_figure import latent_map
from .slice_figures import Source, angle_slices, rusinkiewicz_images, spectra_at

__all__ = [
    "Source",
    "angle_slices",
    "ball_map",
    "latent_map",
    "rusinkiewicz_images",
    "spectra_at",
    "walk_strip",
]
