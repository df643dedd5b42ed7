"""The PLC's cyclic logic: knot ring, playback, stop ramps, joint controllers, faults. Time comes as an argument."""
