"""Gaussian-process models behind the manifold, arrays in and arrays out: kernels, latent variables, encoders."""
