"""The plans: look, orient, calibrate, move, position, return. Pure generators."""
