"""A seeded network with faults, and the fault-injection tests that run the link through it."""
