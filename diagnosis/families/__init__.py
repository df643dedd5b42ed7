"""Families of functions that a remainder may go with, and what foretelling by them gains on held-out folds."""
