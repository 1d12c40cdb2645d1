from ..dls import direct_local_search, hooke_jeeves
from ..gplvm import GPLVM
from ..gpr import GPRegressor, GPWeights
from .decoder import Decoder
from .encoder import Encoder
from .kernels import Kernel, kernel_named
from .lobes import Lobes
from .nonnegative import nonnegative_weights

__all__ = [
    "GPLVM",
    "Decoder",
    "Encoder",
    "GPRegressor",
    "GPWeights",
    "Kernel",
    "Lobes",
    "direct_local_search",
    "hooke_jeeves",
    "kernel_named",
    "nonnegative_weights",
]
