"""Identifications of drawn machines, the truth beside each."""
