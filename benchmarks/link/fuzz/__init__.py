"""Fuzzing of both ends of the link: mutators, oracles after docs/plc-link.md, and the engine. Pure for a seed."""
