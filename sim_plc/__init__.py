"""The simulated machine: PLC program, plant, stereo camera. Its truth leaves it in the truth log only."""
