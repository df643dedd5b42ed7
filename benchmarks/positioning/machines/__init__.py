"""The evidence for the default method: many machines in the fast world, and what each improvement is worth."""
