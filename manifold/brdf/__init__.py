"""Measured BRDFs and what is done with one of them: evaluation, sampling, writing, plausibility."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
