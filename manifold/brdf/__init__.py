"""One BRDF: evaluation, sampling, writing and plausibility of measured ones; analytic ones and the corpus."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
