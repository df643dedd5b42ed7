"""The log of a run: MCAP and CSV with the same content; writing, reading, checking, converting, recovering."""
