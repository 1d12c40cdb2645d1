from .identity import MaterialInfo
from .importing import ImportResult, import_files
from .store import Library

__all__ = [
    "ImportResult",
    "Library",
    "MaterialInfo",
    "import_files",
]
