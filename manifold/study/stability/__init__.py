"""`manifold stability`: a catalogue of failure modes, and whether they are detected."""
