from .representations import Candidate
from .search import Answer, Tolerance

__all__ = [
    "Answer",
    "Candidate",
    "Tolerance",
]
