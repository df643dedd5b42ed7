"""A recording as it was written, the nominal machine, and what is wrong with either before anything is computed."""
