"""What `manifold.principled` fits with: samples, BSDFs and their parameters, optimisers, and fits as JSON."""
