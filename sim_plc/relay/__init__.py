"""A seeded network that misbehaves, and the drills that run the link through it."""
