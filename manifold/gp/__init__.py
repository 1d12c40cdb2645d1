"""Parts of the Gaussian-process method that `manifold.gplvm` and `manifold.gpr` use: kernels, likelihood, encoding."""
