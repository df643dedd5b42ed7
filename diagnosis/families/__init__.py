"""Families of functions that a remainder may go with, and what foretelling by them gains on held-out folds.

Why: a test for anything at all is blind to a small effect among thousands of rows; a name has to be in the library. A
dozen smooth functions of what a stage can depend on come close to what an effect outside the library would do.
"""
