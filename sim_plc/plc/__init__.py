"""The PLC's cyclic program: knot ring, playback, ramps, joint controllers, states. Pure: time comes as an argument."""
