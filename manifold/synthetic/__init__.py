"""Analytic BRDFs, and the built-in corpus made of them."""
