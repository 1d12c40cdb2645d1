"""The loops of `cpp/`, which are compiled when the package is built; `_compiled.pyi` lists them."""

from __future__ import annotations

try:
    from manifold.core import _compiled as loops
except ImportError as error:
    raise ImportError(
        f"manifold: its compiled loops cannot be loaded ({error}); build them with "
        "'python -m pip install --no-deps --editable .' in the sources, which needs a C++ compiler, or install a wheel"
    ) from error

__all__ = ["loops"]
