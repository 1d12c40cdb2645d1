from .bsdf import load_model, register_always

__all__ = ["load_model", "register_always"]
