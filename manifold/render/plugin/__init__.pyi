from .bsdf import register_always

__all__ = [
    "register_always",
]
