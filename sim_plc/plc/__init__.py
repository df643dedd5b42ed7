"""The PLC's cyclic logic: knot ring, playback, stop ramps, joint controllers, faults. Time and samples come as arguments."""
