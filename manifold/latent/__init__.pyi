from ..dls import direct_local_search, hooke_jeeves
from ..gplvm import GPLVM
from ..gpr import GPRegressor, GPWeights
from .decoder import Decoder
from .encoder import Encoder
from .kernels import Kernel, kernel_named
from .lobes import Lobes
from .nonnegative import nonnegative_weights
from .per_band import MonochromeGPLVM

__all__ = [
    "GPLVM",
    "Decoder",
    "Encoder",
    "GPRegressor",
    "GPWeights",
    "Kernel",
    "Lobes",
    "MonochromeGPLVM",
    "direct_local_search",
    "hooke_jeeves",
    "kernel_named",
    "nonnegative_weights",
]
