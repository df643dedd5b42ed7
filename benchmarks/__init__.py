"""Evidence: benches, the reproduction of the paper, fault drills. Part of the source checkout, not of the package."""
