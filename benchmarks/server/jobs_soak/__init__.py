"""Very many jobs in a row with faults injected: does anything grow, and does the server always find back?"""
