from .colours import ColourChoice
from .comparison import BRDFErrors, brdf_errors
from .latent_space import Embedded
from .located import Located, locate
from .manifold import LibraryChangedWarning, Manifold
from .predicted_file import Prediction, predict
from .settings import Settings

__all__ = [
    "BRDFErrors",
    "ColourChoice",
    "Embedded",
    "LibraryChangedWarning",
    "Located",
    "Manifold",
    "Prediction",
    "Settings",
    "brdf_errors",
    "locate",
    "predict",
]
