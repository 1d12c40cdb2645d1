"""Implements `manifold budget`, which finds the cheapest representation of each material that preserves a picture."""
