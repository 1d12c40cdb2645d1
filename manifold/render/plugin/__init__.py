"""The Mitsuba BSDF `manifold`, which evaluates predictions on Dr.Jit arrays from the measured files."""
