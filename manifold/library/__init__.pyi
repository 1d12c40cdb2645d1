from .identity import MaterialInfo
from .importing import ImportResult, import_files
from .store import Library, LibraryInfo

__all__ = [
    "ImportResult",
    "Library",
    "LibraryInfo",
    "MaterialInfo",
    "import_files",
]
