from .colours import ColourChoice
from .located import Located, locate
from .latent_space import Embedded
from .manifold import LibraryChangedWarning, Manifold
from .settings import Settings
from .predicted_file import Prediction, predict

__all__ = [
    "ColourChoice",
    "Embedded",
    "LibraryChangedWarning",
    "Located",
    "Manifold",
    "Prediction",
    "Settings",
    "locate",
    "predict",
]
