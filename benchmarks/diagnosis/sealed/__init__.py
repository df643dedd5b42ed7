"""The blind benchmark's sealed generator: it imports nothing of diagnosis, and diagnosis nothing of it."""
