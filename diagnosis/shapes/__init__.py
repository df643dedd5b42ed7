"""What unknown functions of the signals explain of a residual: a gap has a shape before it has a name.

Why: a test for anything at all is blind to a small effect among thousands of rows; a name has to be in the library. A
dozen smooth functions of what a stage can depend on come close to what an effect outside the library would do.
"""
