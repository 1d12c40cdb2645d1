from . import budget, chart, evaluation, stability

__all__ = ["budget", "chart", "evaluation", "stability"]
