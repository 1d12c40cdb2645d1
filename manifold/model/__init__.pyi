from .colours import ColourChoice
from .located import Located, locate
from .manifold import Embedded, LibraryChangedWarning, Manifold, Settings
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
