"""`manifold budget`: no more model than a scene needs."""
