"""One cell of a residual: which effects may be named, their fits, held-out scores, and which a margin believes."""
