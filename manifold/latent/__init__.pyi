from ..dls import direct_local_search, hooke_jeeves
from ..estimators import GPRegressor
from ..gplvm import GPLVM
from ..gpr import GaussianProcess
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
    "GaussianProcess",
    "Kernel",
    "Lobes",
    "direct_local_search",
    "hooke_jeeves",
    "kernel_named",
    "nonnegative_weights",
]
