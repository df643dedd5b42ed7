"""Targets without markers: measured patches, faults, and whole jobs on bare rock."""
