"""Implements `manifold stability`, a catalogue of failure modes that shows whether they are detected."""
