from .colours import ColourChoice
from .comparison import brdf_errors
from .latent_space import Embedded
from .located import Located, Reconstruction, locate
from .manifold import LibraryChangedWarning, Manifold
from .output_file import OutputOptions
from .settings import Settings

__all__ = [
    "ColourChoice",
    "Embedded",
    "LibraryChangedWarning",
    "Located",
    "Manifold",
    "OutputOptions",
    "Reconstruction",
    "Settings",
    "brdf_errors",
    "locate",
]
