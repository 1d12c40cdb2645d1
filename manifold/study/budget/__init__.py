"""`manifold budget`: the cheapest representation of each material that preserves a scene's image."""
