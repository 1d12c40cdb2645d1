from .exporting import Shader, export, make_shader
from .table import ShaderTable

__all__ = [
    "Shader",
    "ShaderTable",
    "export",
    "make_shader",
]
