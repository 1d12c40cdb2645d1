from .page import make_page
from .tables import Tables, tabulate

__all__ = [
    "Tables",
    "make_page",
    "tabulate",
]
