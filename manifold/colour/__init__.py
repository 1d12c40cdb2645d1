"""Spectra, illuminants, reflectances and colour differences. These modules alone import colour-science."""
