"""The catalogue: one effect a file."""
