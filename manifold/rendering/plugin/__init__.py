"""The Mitsuba BSDF plugin `manifold`: predictions on Dr.Jit arrays, straight from the measured files."""
