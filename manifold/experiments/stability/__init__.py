"""`manifold stability`: where methods fail, and whether they say so."""
