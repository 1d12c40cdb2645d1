"""Measured BRDFs and what is done with one of them: evaluation, sampling, writing, plausibility."""
