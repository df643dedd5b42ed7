"""How much a signal varies by itself, what whitens it, and what a whole day of a machine is off by."""
