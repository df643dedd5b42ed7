"""Local calibration: how camera vectors turn into base vectors, and the reference that follows. Pure."""
