"""The simulated machine: PLC program, plant, stereo camera. Its truth never leaves this package but into the truth log."""
