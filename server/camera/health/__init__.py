"""Health of the camera: every fault found, named with its remedy, and kept out of the looks."""
