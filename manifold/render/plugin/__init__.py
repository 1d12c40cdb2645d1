"""The Mitsuba BSDF `manifold`: predictions on Dr.Jit arrays, straight from the measured files."""
