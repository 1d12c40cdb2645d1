"""What `manifold.fitting.principled` fits with: samples, BSDFs and their parameters, optimisers, and fits as JSON."""
