"""Targets without markers: a place on a surface is measured, found again, and served as the object of interest."""
