"""`longreach bench hold`: from letting go of the button in a real browser to the ramp in the PLC's own states."""
