from .page import make_page
from .page_data import Tables, tabulate

__all__ = [
    "Tables",
    "make_page",
    "tabulate",
]
