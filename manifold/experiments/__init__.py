"""Experiments on fitted models: held-out accuracy, speed against accuracy, failure modes, least models for a scene."""
