"""`manifold chart`: speed against accuracy."""
