"""Shrink of the gap in the simulator: its plant driven by a recording, with and without the effects."""
