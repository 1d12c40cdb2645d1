from ..dls import direct_local_search, hooke_jeeves
from ..gplvm import GPLVM
from ..gpr import GPRegressor, GPWeights
from .encoding import Decoder
from .kernels import Kernel, kernel_named
from .likelihood_encoding import LikelihoodEncoder
from .per_band import MonochromeGPLVM
from .sparse import SparseGPLVM

__all__ = [
    "GPLVM",
    "Decoder",
    "GPRegressor",
    "GPWeights",
    "Kernel",
    "LikelihoodEncoder",
    "MonochromeGPLVM",
    "SparseGPLVM",
    "direct_local_search",
    "hooke_jeeves",
    "kernel_named",
]
